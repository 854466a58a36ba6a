"""The server of the window: one page for one browser, on this machine alone.

Requests must carry the token of the address and name this machine as their host, and a connection
must come from the page itself: other pages of the same browser cannot reach it.
"""

import asyncio
import json
import secrets
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import equinox as eqx
from aiohttp import WSMsgType, web

from ...base.errors import InputError
from ...scene.scene import Scene
from .fitting import RunningFit
from .frames import Frame
from .session import Session

HOST = "127.0.0.1"
_FILES = {"": "index.html", "view.js": "view.js", "view.css": "view.css"}
_TYPES = {"html": "text/html", "js": "text/javascript", "css": "text/css"}

# The seconds after which a frame that is not ready is said to be compiled.
_COMPILING = 0.4

# The messages that come from frame to frame while something is dragged.
_DRAGS = ("camera", "light", "set")

# The seconds above which frames are drawn with single rays while something is dragged, and those
# after which a frame is refined when nothing moves any more.
_SLOW, _REST = 0.08, 0.15


@dataclass
class Window:
    """A session, the browsers that show it, and what is still to be drawn."""

    session: Session
    save_as: Path  #: where the scene is saved by default
    fit_settings: dict[str, Any]
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    sockets: set[web.WebSocketResponse] = field(default_factory=set)
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    fit: RunningFit | None = None
    said: dict[str, Any] = field(default_factory=dict)  #: words that go with the next state
    #: draws; not asyncio's own, for whose compilations the end of the program would wait
    worker: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1))
    moving: bool = False  #: whether something was dragged since the last frame

    def application(self) -> web.Application:
        """Returns the web application."""
        app = web.Application(middlewares=[self._guarded])
        app.router.add_get(f"/{self.token}/ws", self._connect)
        for name in _FILES:
            app.router.add_get(f"/{self.token}/{name}", self._file)
        app.cleanup_ctx.append(self._drawing)
        return app

    # --- requests -------------------------------------------------------------------------------

    @web.middleware
    async def _guarded(self, request: web.Request, handler: Callable) -> web.StreamResponse:
        """Refuses requests of other hosts and pages; without the token nothing is found at all."""
        assert request.transport is not None
        port = request.transport.get_extra_info("sockname")[1]
        hosts = {f"{HOST}:{port}", f"localhost:{port}"}
        origin = request.headers.get("Origin")
        if request.host not in hosts or (origin and origin not in {f"http://{h}" for h in hosts}):
            raise web.HTTPForbidden(text="this page is for this machine only")
        given = request.path.split("/")[1].encode(errors="surrogateescape")
        if not secrets.compare_digest(given, self.token.encode()):
            raise web.HTTPForbidden(text="the address has another token: see the terminal")
        return await handler(request)

    async def _file(self, request: web.Request) -> web.Response:
        name = _FILES[request.path.rsplit("/", 1)[1]]
        text = (resources.files("spheretrace_jax.display.view") / "page" / name).read_text(
            encoding="utf-8"
        )
        policy = "default-src 'self'; connect-src 'self'; img-src 'self' data:"
        return web.Response(
            text=text,
            content_type=_TYPES[name.rsplit(".", 1)[1]],
            headers={"Content-Security-Policy": policy, "Referrer-Policy": "no-referrer"},
        )

    async def _connect(self, request: web.Request) -> web.WebSocketResponse:
        """Serves a browser: takes its messages until it leaves."""
        socket = web.WebSocketResponse(
            max_msg_size=1 << 16,
            compress=False,  # to compress a frame of 512x512 takes 33 ms, to draw it 9
        )
        await socket.prepare(request)
        self.sockets.add(socket)
        self.changed.set()
        try:
            async for message in socket:
                if message.type == WSMsgType.TEXT:
                    self._take(message.data)
        finally:
            self.sockets.discard(socket)
        return socket

    def _take(self, text: str) -> None:
        """Takes a message; one that cannot be is answered in words."""
        try:
            message = json.loads(text)
            if not isinstance(message, dict):
                raise InputError("expected a message with a type")
            kind = message.get("type")
            if kind == "fit":
                self._start_fit()
            elif kind == "stop":
                self.stop_fit()
            elif kind == "save":
                path = Path(str(message.get("path") or self.save_as))
                self.said["note"] = self.session.save(path, bool(message.get("overwrite")))
            elif kind == "pick":  # which draws, so not here
                asyncio.get_running_loop().create_task(self._pick(message))
            else:
                self.session.take(message)
                self.moving = self.moving or kind in _DRAGS
        except (InputError, OSError, ValueError, RecursionError) as error:
            self.said["error"] = " ".join(str(error).split())
        self.changed.set()

    async def _pick(self, message: dict[str, Any]) -> None:
        """Chooses the sphere at a pixel."""
        loop = asyncio.get_running_loop()
        try:
            await loop.run_in_executor(self.worker, self.session.take, message)
        except InputError as error:
            self.said["error"] = str(error)
        self.changed.set()

    # --- fits -----------------------------------------------------------------------------------

    def _start_fit(self) -> None:
        session, loop = self.session, asyncio.get_running_loop()
        if session.target is None:
            raise InputError("there is no target: start with --target PICTURE")
        if self.fit is not None and self.fit.running:
            raise InputError("a fit is running already")
        session.take({"type": "begin"})
        self.said["fit"] = "compiling the fit"

        def show(scene: Scene | None, words: str, grade: str = "") -> None:
            if scene is not None:  # the camera is the user's, who may turn it meanwhile
                session.scene = eqx.tree_at(lambda s: s.camera, scene, session.scene.camera)
            self.said |= {"fit": words, "grade": grade, "fitting": not grade}
            self.changed.set()

        def tell(scene: Scene | None, words: str, grade: str = "") -> None:
            loop.call_soon_threadsafe(show, scene, words, grade)

        self.fit = RunningFit(
            session.scene, session.target, tell, tell, bounces=session.bounces, **self.fit_settings
        )

    def stop_fit(self) -> None:
        """Ends a fit after its present step."""
        if self.fit is not None:
            self.fit.stop()

    # --- frames ---------------------------------------------------------------------------------

    async def _drawing(self, app: web.Application) -> AsyncIterator[None]:
        """Draws while the application runs."""
        task = asyncio.create_task(self._draw_forever())
        yield
        self.stop_fit()
        task.cancel()
        for socket in set(self.sockets):
            await socket.close()

    async def _draw_forever(self) -> None:
        """Draws the newest state, again and again: states that came meanwhile are left out.

        Where frames are slow, those of a drag have single rays, and the last is drawn once more.
        """
        loop = asyncio.get_running_loop()
        known, slow, rough = set(), False, False
        while True:
            with suppress(TimeoutError):
                await asyncio.wait_for(self.changed.wait(), _REST if rough else None)
            self.changed.clear()
            if not self.sockets:
                continue
            rough = slow and self.moving and bool(self.session.scene.antialias)
            self.moving, began = False, loop.time()
            said, self.said = self.said, {}  # later words go with the next frame
            try:
                draw = self.session.frame(rough)
                drawing = loop.run_in_executor(self.worker, draw)
                done, _ = await asyncio.wait([drawing], timeout=_COMPILING)
                if not done:
                    await self._send(
                        {"busy": "compiling" if draw.args[1:2] not in known else "drawing"}
                    )
                frame = await drawing
            except Exception as error:  # whatever it is, the window goes on
                await self._send(
                    {**said, "error": f"cannot draw this: {' '.join(str(error).split())}"}
                )
                continue
            seconds = loop.time() - began
            if not rough:
                slow = draw.args[1:2] in known and seconds > _SLOW  # the first time compiles
                known.add(draw.args[1:2])
            state = {**self.session.state(), **said, "seconds": seconds, "rough": rough}
            await self._send(state, frame)

    async def _send(self, state: dict[str, Any], frame: Frame | None = None) -> None:
        """Sends a state and then its frame to all browsers; those that left are forgotten."""
        if frame is not None:
            state = {**state, "scale": frame.scale, "save": str(self.save_as)}
        for socket in set(self.sockets):
            try:
                await socket.send_str(json.dumps(state))
                if frame is not None:
                    await socket.send_bytes(frame.pixels.tobytes())
            except (ConnectionError, RuntimeError):
                self.sockets.discard(socket)


async def serve(window: Window, port: int, ready: Callable[[str], Any]) -> None:
    """Serves a window until the task is cancelled.

    **Arguments:** `port`: 0 for any that is free. `ready`: called with the address.

    **Raises:** `OSError` if the port is taken.
    """
    runner = web.AppRunner(window.application(), access_log=None, shutdown_timeout=1.0)
    await runner.setup()
    try:
        site = web.TCPSite(runner, HOST, port)
        await site.start()
        bound = runner.addresses[0][1]
        ready(f"http://{HOST}:{bound}/{window.token}/")
        await asyncio.Event().wait()
    finally:
        await runner.cleanup()
