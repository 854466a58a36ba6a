"""The server of the window: who may connect, what it sends, fits, saving, and its command."""

import asyncio
import json
import subprocess
import sys
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import spheretrace
from helpers.scenes import SCENES

import spheretrace_jax as st

pytest.importorskip("aiohttp", reason="the extra `view` is not installed")

from aiohttp import WSServerHandshakeError
from aiohttp.test_utils import TestClient, TestServer

from spheretrace_jax.display.view.server import Window
from spheretrace_jax.display.view.session import Session

SIZE = (24, 16)
SCENE = SCENES["diffuse"].astype("float32")


@asynccontextmanager
async def served(tmp_path, target=None):
    """Yields a window and a client of its server."""
    window = Window(Session(SCENE, SIZE, target), tmp_path / "edited.txt", {"free": ("kd",)})
    async with TestClient(TestServer(window.application())) as client:
        yield window, client


@asynccontextmanager
async def connected(tmp_path, target=None):
    """Yields a window, and its connection after the first frame."""
    async with served(tmp_path, target) as (window, client):
        async with client.ws_connect(f"/{window.token}/ws") as socket:
            await frame(socket)
            yield window, socket


async def frame(socket, until=lambda state: True):
    """Returns the next state that is wanted, and its pixels."""
    while True:
        state = json.loads((await socket.receive(timeout=60)).data)
        if "size" not in state:
            continue
        pixels = np.frombuffer((await socket.receive(timeout=60)).data, np.uint8)
        if until(state):
            return state, pixels.reshape(SIZE[1], SIZE[0], 4)


def test_frames_follow_messages(tmp_path):
    async def check():
        async with connected(tmp_path) as (_, socket):
            await socket.send_json({"type": "set", "name": "kd", "value": 0.0, "row": 1})
            state, pixels = await frame(socket, lambda s: s["values"]["kd"][1] == 0)
            kd = SCENE.spheres.kd.at[1].set(0)
            picture = st.render(st.replace(SCENE, {"kd": kd}), width=24, height=16)
            expected = np.round(st.to_srgb(picture) * 255)
            np.testing.assert_allclose(pixels[..., :3], expected, atol=1)
            assert state["seconds"] > 0 and state["sphere"] == 0

    asyncio.run(check())


def test_stale_states_are_not_drawn(tmp_path):
    async def check():
        async with connected(tmp_path) as (window, socket):
            drawn = []
            draw = window.session.frame
            window.session.frame = lambda *rough: drawn.append(1) or draw(*rough)
            for k in range(200):
                await socket.send_json({"type": "camera", "theta": k / 1000})
            await frame(socket, lambda s: s["values"]["theta"] == pytest.approx(0.199))
            assert len(drawn) < 100

    asyncio.run(check())


def test_mistakes_are_one_line_and_the_window_goes_on(tmp_path):
    async def check():
        async with connected(tmp_path) as (_, socket):
            for text in (
                "{",
                "3",
                "[" * 60000,
                '{"type": []}',
                '{"type": "options", "bounces": 1e999}',
                '{"type": "set", "name": "radius", "value": -1}',
            ):
                await socket.send_str(text)
                state, _ = await frame(socket, lambda s: "error" in s)
                assert state["error"] and "\n" not in state["error"]

    asyncio.run(check())


def test_only_the_page_itself_may_connect(tmp_path):
    async def check():
        async with served(tmp_path) as (window, client):
            here = f"/{window.token}/"
            page = await client.get(here)
            assert page.status == 200 and "spheretrace view" in await page.text()
            assert "default-src 'self'" in page.headers["Content-Security-Policy"]
            for name in ("view.js", "view.css"):
                assert (await client.get(here + name)).status == 200
            refused = [
                client.get("/"),
                client.get("/wrong/"),
                client.get("/é/"),
                client.get(f"/{window.token[:-1]}/"),
                client.get(here, headers={"Host": "evil.example"}),
                client.get(here, headers={"Host": "127.0.0.1:1"}),
                client.get(here, headers={"Origin": "http://evil.example"}),
            ]
            assert [(await answer).status for answer in refused] == [403] * len(refused)
            assert (await client.get(here + "no")).status == 404
            for path, headers in (("/wrong/ws", {}), (here + "ws", {"Origin": "http://evil"})):
                with pytest.raises(WSServerHandshakeError, match="403"):
                    await client.ws_connect(path, headers=headers)

    asyncio.run(check())


def test_a_scene_is_saved_but_not_over_another(tmp_path):
    async def check():
        async with connected(tmp_path) as (_, socket):
            await socket.send_json({"type": "save"})
            state, _ = await frame(socket, lambda s: "note" in s)
            file = tmp_path / "edited.txt"
            assert state["note"] == f"saved {file}"
            np.testing.assert_array_equal(
                st.load_scene(file, np.float32).spheres.kd, SCENE.spheres.kd
            )
            before = file.read_bytes()
            await socket.send_json({"type": "set", "name": "kd", "value": 0.0})
            for message, key in (({}, "error"), ({"overwrite": True}, "note")):
                await socket.send_json({"type": "save", "path": str(file), **message})
                state, _ = await frame(socket, lambda s, key=key: key in s)
                assert (file.read_bytes() == before) == (key == "error")
            await socket.send_json({"type": "save", "path": str(tmp_path / "none" / "a.txt")})
            assert "there is no folder" in (await frame(socket, lambda s: "error" in s))[0]["error"]

    asyncio.run(check())


@pytest.mark.slow
def test_a_fit_is_shown_step_by_step(tmp_path):
    truth = st.replace(SCENE, {"kd": 0.4})
    target = np.asarray(st.render(truth, width=24, height=16))

    async def check():
        async with connected(tmp_path, target) as (window, socket):
            await socket.send_json({"type": "fit"})
            seen = []
            while True:
                state, _ = await frame(socket, lambda s: "fit" in s)
                seen.append(state["fit"])
                if state.get("grade"):
                    break
            assert seen[0] == "compiling the fit" and any(s.startswith("step ") for s in seen)
            assert state["grade"] == "exact" and "converged" in state["fit"]
            np.testing.assert_allclose(window.session.scene.spheres.kd, 0.4, rtol=1e-3)
            await socket.send_json({"type": "undo"})
            state, _ = await frame(socket)
            np.testing.assert_allclose(state["values"]["kd"], SCENE.spheres.kd, rtol=1e-6)

    asyncio.run(check())


def test_a_fit_without_a_target_is_refused(tmp_path):
    async def check():
        async with connected(tmp_path) as (_, socket):
            await socket.send_json({"type": "fit"})
            state, _ = await frame(socket, lambda s: "error" in s)
            assert state["error"] == "there is no target: start with --target PICTURE"

    asyncio.run(check())


def test_mistakes_of_the_command_are_one_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    st.save_scene("scene.txt", SCENE)
    st.write_image("target.png", np.zeros((16, 24, 3)))
    sized = ("view", "scene.txt", "--target", "target.png", "--size", "16x16")
    assert spheretrace(*sized) == (
        2, "", "spheretrace: --size must be that of the target, 24x16, got 16x16\n",
    )  # fmt: skip
    status, _, err = spheretrace("view", "scene.txt", "--port", "99999")
    assert (status, err) == (2, "spheretrace: --port must be in 0..65535, got 99999\n")
    monkeypatch.setitem(sys.modules, "spheretrace_jax.display.view.server", None)
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    monkeypatch.delitem(sys.modules, "spheretrace_jax.display.view.server")
    status, _, err = spheretrace("view", "scene.txt")
    assert status == 2 and "needs the extra view: pip install 'spheretrace_jax[view]'" in err


@pytest.mark.slow
def test_the_command_serves_until_it_is_interrupted(tmp_path):
    st.save_scene(tmp_path / "scene.txt", SCENE)
    program = "from spheretrace_jax.cli.main import main; main()"
    words = [sys.executable, "-c", program, "view", "scene.txt", "--no-browser", "--no-cache"]
    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        said = process.stdout.readline()
        assert said.startswith("scene.txt: http://127.0.0.1:") and "Ctrl-C ends it" in said
        process.send_signal(2)
        assert process.wait(timeout=30) == 130
    assert [f.name for f in Path(tmp_path).iterdir()] == ["scene.txt"]
