"""Bad files, faults of the machine, half precision.
Broken files, full disks, interrupts. An error is one line that names the mistake and its position,
with exit status 2. A file is written completely, or the old file stays.
"""

import re
import signal
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path
from unittest.mock import patch

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from helpers.commands import FIT, WRITING, files, read_only, spheretrace, workplace
from helpers.fuzz import fuzz_pictures, fuzz_scenes, good_pictures, peak

import spheretrace_jax as st
from extremes.case import case
from spheretrace_jax.fit.model.target import make_target

# --- broken files ---------------------------------------------------------------------------------


@case(
    "20,000 scene files with words and bytes changed, put in, taken out, cut off",
    "read to finite numbers that a file keeps to the last bit, or refused with line and column",
    slow=True,
)
def scenes() -> str:
    return str(fuzz_scenes(20_000))


@case(
    "10,000 pictures in 12 formats with bytes changed, most in their headers",
    "read, or refused in one line; no crash, none takes 10 s or 1 GB",
    slow=True,
)
def pictures() -> str:
    return str(fuzz_pictures(0, 10_000))


def claiming(name: str, data: bytes, size: int) -> bytes:
    """Changes a picture's header to claim so many pixels of width and height."""
    size16 = struct.pack(">HH", size, size)
    ending = Path(name).suffix
    if ending == ".exr":
        box = rb"(Window\0box2i\0....).{16}"
        return re.sub(box, rb"\1" + struct.pack("<4i", 0, 0, size - 1, size - 1), data, flags=re.S)
    if ending == ".png":
        chunk = b"IHDR" + struct.pack(">II", size, size) + data[24:29]
        return data[:12] + chunk + struct.pack(">I", zlib.crc32(chunk)) + data[33:]
    if ending == ".jpg":
        return re.sub(rb"(\xff\xc0...)....", lambda m: m[1] + size16, data, count=1, flags=re.S)
    if ending == ".tif":  # tags 256 and 257 of the directory, as numbers of 32 bits
        (start,) = struct.unpack_from("<I", data, 4)
        for tag in (256, 257):
            entry = data.index(struct.pack("<H", tag), start)
            data = data[:entry] + struct.pack("<HHII", tag, 4, 1, size) + data[entry + 12 :]
        return data
    return data.replace(b"5 6\n", f"{size} {size}\n".encode()).replace(
        b"-Y 6 +X 5", f"-Y {size} +X {size}".encode()
    )


FORMATS = ("a.exr", "a.png", "a.jpg", "a.tif", "a.hdr", "a.ppm")


def refused_headers(size: int) -> str:
    """Asserts that headers which claim so many pixels along each side are refused."""
    with workplace() as folder:
        good = good_pictures(folder)
        before, start = peak(), time.perf_counter()
        for name in FORMATS:
            (folder / name).write_bytes(claiming(name, good[name], size))
            try:
                st.read_image(folder / name)
            except st.PictureError as error:
                assert str(error).startswith(f"{folder / name}: "), error
                assert f"got {size} x {size} x 1" in str(error) or "header claims" in str(error)
            else:
                raise AssertionError(f"{name} was read")
    grown, seconds = peak() - before, time.perf_counter() - start
    assert grown < 50 and seconds < 2
    return f"{len(FORMATS)} refused in {seconds:.2f} s, memory grew by {grown} MB"


@case(
    "headers of 6 formats that claim 10⁹ pixels, in files of 1 kB",
    "refused before memory is taken",
)
def headers() -> str:
    return refused_headers(32_000)


@case(
    "the same for 2.5·10⁸ pixels, as many as a picture may have",
    "refused before memory is taken, as the files are short",
    "libjpeg, which invents missing pixels: 36 s and 6 GB",
)
def large_headers() -> str:
    return refused_headers(16_000)


# --- faults ---------------------------------------------------------------------------------------


def start(*words: str, limit: str = "") -> subprocess.Popen:
    """Starts the program in another process, which prints a line when it is loaded."""
    program = (
        f"import resource; {limit}\n"
        "from spheretrace_jax.cli import main; print('loaded', flush=True); main.main()"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", program, *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert child.stdout is not None and child.stdout.readline() == "loaded\n"
    return child


def ended(child: subprocess.Popen) -> tuple[int, str, str]:
    out, err = child.communicate(timeout=300)
    return child.returncode, out, err


@case(
    "a full disk: render to PNG and EXR, fit, convert, demo",
    "status 2, one line that names the file, the old file stays and no other",
    "RLIMIT_FSIZE, in other processes",
    slow=True,
)
def full_disk() -> str:
    commands = WRITING | {"demo": (("demo", "-o", "."), ["fitted.txt"])}
    limit = "resource.setrlimit(resource.RLIMIT_FSIZE, (128, 128))"
    with workplace() as folder:
        for words, (name,) in commands.values():
            Path(name).write_text("old")
            before = files(folder)
            status, out, err = ended(start(*words, limit=limit))
            *warnings, said = err.splitlines()
            assert (status, out, said) == (2, "", f"spheretrace: {name}: File too large"), err
            assert all(line.startswith("spheretrace: warning: ") for line in warnings), err
            assert files(folder) == before
    return f"{len(commands)} of {len(commands)}"


@case(
    "a full device, and a closed pipe, as standard output",
    "status 2 and one line; the file is written",
    "/dev/full",
)
def full_output() -> str:
    said = "spheretrace: standard output: "
    with workplace():
        program = "-m spheretrace_jax.cli convert scene.txt out.pov"
        for shell, reason in (
            ("> /dev/full", "No space left on device"),
            ("| true; exit ${PIPESTATUS[0]}", "Broken pipe"),
        ):
            words = ["bash", "-c", f"{sys.executable} {program} {shell}"]
            done = subprocess.run(words, capture_output=True, text=True)
            assert (done.returncode, done.stderr) == (2, f"{said}{reason}\n"), done
            assert Path("out.pov").read_text().startswith("// made from scene.txt")
            Path("out.pov").unlink()
    return "both"


@case(
    "a folder without write permission: all commands that write, reports and demos in it",
    "status 2 and one line before anything is computed",
)
def read_only_folder() -> str:
    commands = {name: (words, file) for name, (words, (file,)) in WRITING.items()}
    commands["report"] = (*FIT[:4], "open/fitted.txt", "--report", "new"), "new"
    commands["demo"] = ("demo", "-o", "new/demo"), "new/demo"
    computed = AssertionError("computed for nothing")
    with (
        workplace() as folder,
        patch.object(st, "render", side_effect=computed),
        patch.object(st, "fit", side_effect=computed),
    ):
        spheretrace("fit", "--help")  # root's libraries are loaded
        Path("open").mkdir()
        Path("open").chmod(0o777)
        before = files(folder)
        for words, file in commands.values():
            with read_only(folder):
                found = spheretrace(*words)
            said = f"spheretrace: {file}: the folder . cannot be written to\n"
            assert found == (2, "", said), found
            assert files(folder) == before
    return f"{len(commands)} of {len(commands)}"


@case(
    "Ctrl-C at 12 moments of a rendering and of a fit",
    "status 130 and one line; the old file stays, or it is the best scene so far; no other file",
    slow=True,
)
def interrupted() -> str:
    kept = 0
    with workplace() as folder:
        for words, (name,) in (WRITING["render exr"], WRITING["fit"]):
            began = time.perf_counter()
            assert ended(start(*words))[0] == 0
            whole = time.perf_counter() - began
            for k in range(12):
                Path(name).write_text("old")
                before = files(folder)
                child = start(*words)
                time.sleep(whole * k / 12)
                child.send_signal(signal.SIGINT)
                status, out, err = ended(child)
                assert files(folder).keys() == before.keys()
                if files(folder) == before:
                    said = "spheretrace: interrupted\n"
                    assert (status, out, err) == (130, "", said), (k, status, out, err)
                    kept += 1
                else:  # during the fit, its diagnosis, or the exit of Python
                    assert status in (130, 0, -signal.SIGINT), (k, status, err)
                    assert err in ("", "spheretrace: interrupted\n"), (k, status, err)
                    if words[0] == "fit":
                        assert len(st.load_scene(name).spheres) == 2
                    else:
                        assert st.read_image(name).shape == (24, 32, 3)
    return f"{kept} of 24 before anything was written, {24 - kept} after"


@case(
    "a picture of 16,000 × 16,000 pixels where there is less memory",
    "status 2 and one line",
    "RLIMIT_AS",
    slow=True,
)
def no_memory() -> str:
    with workplace() as folder:
        before = files(folder)
        words = ("render", "scene.txt", "-o", "out.exr", "--size", "16000x16000")
        limit = "resource.setrlimit(resource.RLIMIT_AS, (6 << 30, 6 << 30))"  # JAX takes some
        found = ended(start(*words, limit=limit))
        assert found == (2, "", "spheretrace: there is not enough memory for this picture\n")
        assert files(folder) == before
    return "one line"


# --- half precision -------------------------------------------------------------------------------

SCENE = st.Scene(
    st.Spheres([[0.0, 0, 0]], [100.0]),
    st.Lights([[1.0, 2, 300]]),
    back_plane=st.BackPlane((1.0, 1, 1)),
    sky=st.Texture(np.ones((2, 2, 3))),
)
OTHERS = (jnp.float16, jnp.bfloat16, jnp.complex64, jnp.bool_)


@case(
    "arrays of float16, bfloat16, complex and bool numbers in a scene",
    "refused in one line, in every part and by all that uses a scene; integers are converted",
)
def half_scenes() -> str:
    tried = 0
    for dtype in OTHERS:
        one, row = jnp.ones(1, dtype), jnp.ones((1, 3), dtype)
        changed = jax.tree.map(lambda leaf: leaf.astype(dtype), SCENE)
        moved = eqx.tree_at(lambda s: s.lights.position, SCENE, row)
        needs = st.needs(SCENE)
        picture = np.full((4, 4, 3), 0.5)
        for use in (
            lambda: st.Spheres(row, one),
            lambda: st.Spheres([[0.0, 0, 0]], [1.0], ka=one),
            lambda: st.Lights(row),
            lambda: st.Planes(row, [[0.0, 0, 1]]),
            lambda: st.BackPlane(row[0]),
            lambda: st.Texture(row[None]),
            lambda: st.Camera(mu=one[0]),
            lambda: st.Scene(SCENE.spheres, SCENE.lights, background=row[0]),
            lambda: SCENE.astype(dtype),
            lambda: st.render(changed, width=4, height=4),
            lambda: st.render(moved, width=4, height=4),
            lambda: jax.jit(lambda s: st.render(s, needs=needs))(changed),
            lambda: st.needs(changed),
            lambda: st.fit(changed, picture),
            lambda: st.check_gradients(changed),
            lambda: st.save_scene("never.txt", changed),
            lambda: st.write_povray("never.pov", changed),
            lambda: st.load_scene("never.txt", dtype),
        ):
            tried += 1
            try:
                use()
            except st.InputError as error:
                assert str(error).endswith(f", got {np.dtype(dtype)}"), error
            else:
                raise AssertionError(f"use {tried} of {np.dtype(dtype)} was not refused")
    whole = st.Spheres(np.zeros((1, 3), int), np.ones(1, np.uint8))
    assert whole.radius.dtype == whole.center.dtype == jnp.asarray(0.0).dtype
    return f"{tried} refused"


@case(
    "float16 and bfloat16 targets, weights and noise of a fit, and EXR files in half precision",
    "promoted: as if the same numbers were given in float32",
)
def half_targets() -> str:
    numbers = np.random.default_rng(0).uniform(0.1, 0.9, (4, 5, 3)).astype(np.float32)
    for dtype in (jnp.float16, jnp.bfloat16):
        half = jnp.asarray(numbers, dtype)
        wide = np.asarray(half.astype(jnp.float32))
        for ours in map(np.dtype, (np.float32, np.float64)):
            a, b = (make_target(x, ours, weights=x, noise=x) for x in (half, wide))
            assert eqx.tree_equal(a, b) and a.image.dtype == a.weight.dtype == ours
    with workplace():
        st.write_image("half.exr", numbers, bits=16)
        found = st.read_image("half.exr")
    assert found.dtype == np.float32
    np.testing.assert_array_equal(found, numbers.astype(np.float16))
    return "the same to the last bit"
