"""Serves the console over a web page: one process of the console for each page that is open.

The terminal in the page is textual-serve's; the page around it is ours, and nothing is loaded from
elsewhere. All of it is on loopback, and another site's page in the same browser must not reach the
fleet: names other than loopback and foreign origins are refused.

Pages that can order stand behind a key, which is the first part of every path. A cookie would not
keep it safe: browsers send the cookies of one port of this machine to all others.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import html
from collections.abc import Awaitable, Callable
from pathlib import Path
from string import Template
from urllib.parse import urlsplit

import textual_serve
from aiohttp import WSCloseCode, WSMsgType, web

from groundstation.web.console_process import END_TIMEOUT_S, ConsoleProcess
from onboard.config.endpoints import is_loopback
from onboard.config.file_reading import json_values
from onboard.config.fleet import ConfigError

MAX_PAGES = 12
MAX_CELLS = 1000  # of a terminal, in each direction
_FONT_SIZES = (6, 60)  # least and most
_DEFAULT_FONT_SIZE = "16"
_FOLDER = Path(__file__).parent
_STATIC = Path(textual_serve.__file__).parent / "static"
_TYPES = {"page.css": "text/css", "page.js": "text/javascript"}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; font-src 'self'; "
        "img-src 'self' data:; connect-src 'self' ws://{host}; frame-ancestors 'none'; "
        "base-uri 'none'; form-action 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def require_loopback(host: str) -> str:
    """Return the host if only this machine can reach it; ConfigError in words otherwise."""
    if is_loopback(host):
        return host
    raise ConfigError(
        f"--host {host}: the console in the browser is for this machine only, since whoever opens "
        "the page sees the fleet. Leave --host out, and from another machine go through ssh: "
        "ssh -L 8000:127.0.0.1:8000 here."
    )


class ConsoleServer:
    """Pages of one command.

    Args:
        command: the console's program with its arguments.
        title: of the page.
        ended: sentence in the page when its console has ended.
        key: first part of every path; without it nothing is served. Empty: there is none.
    """

    def __init__(self, command: list[str], *, title: str, ended: str, key: str = "") -> None:
        self._command = command
        self._title = title
        self._ended = ended
        self._key = key
        # The consoles of the open pages, with the tasks that serve these.
        self._open: dict[ConsoleProcess, asyncio.Task[object]] = {}
        self._runner: web.AppRunner | None = None
        self._is_stopping = False

    @property
    def pages(self) -> int:
        """Number of open pages."""
        return len(self._open)

    @property
    def pids(self) -> frozenset[int]:
        """Process ids of the consoles of the open pages."""
        return frozenset(console.pid for console in self._open if console.pid is not None)

    async def start(self, host: str, port: int) -> str:
        """Begin to serve.

        Returns:
            The address of the page.

        Raises:
            ConfigError: the port is taken.
        """
        base = f"/{self._key}" if self._key else ""
        app = web.Application(middlewares=[self._admit])
        app.router.add_get(f"{base}/", self._page)
        app.router.add_get(f"{base}/ws", self._socket)
        for name in _TYPES:
            app.router.add_get(f"{base}/{name}", _file)
        app.router.add_static(f"{base}/static", _STATIC, show_index=False)

        runner = web.AppRunner(app, access_log=None, shutdown_timeout=END_TIMEOUT_S)
        self._runner = runner
        await runner.setup()
        try:
            await web.TCPSite(runner, host.strip("[]"), port).start()
        except OSError as error:
            await self.stop()
            reason = error.strerror or error
            raise ConfigError(
                f"--port {port}: {reason}. Choose another, or 0 for any that is free."
            ) from None

        own_host, own_port, *_ = runner.addresses[0]
        if ":" in str(own_host):  # IPv6
            own_host = f"[{own_host}]"
        return f"http://{own_host}:{own_port}{base}/"

    async def stop(self) -> None:
        """End all pages and their consoles; none of them is left afterwards."""
        self._is_stopping = True

        tasks = list(self._open.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

        if self._runner is not None:
            await self._runner.cleanup()

    async def _page(self, request: web.Request) -> web.Response:
        values = {
            "title": html.escape(self._title),
            "ended": html.escape(self._ended),
            "socket": html.escape(f"ws://{request.host}{request.path}ws"),
            "font_size": _font_size(request.query.get("fontsize", "")),
        }
        page = Template((_FOLDER / "page.html").read_text(encoding="utf-8"))
        return web.Response(text=page.substitute(values), content_type="text/html")

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        """Serve one page: a console of its own, for as long as the page is open."""
        socket = web.WebSocketResponse(timeout=END_TIMEOUT_S, heartbeat=15.0, max_msg_size=65_536)
        await socket.prepare(request)
        if self._is_stopping or len(self._open) >= MAX_PAGES:
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many pages are open")
            return socket

        console = ConsoleProcess(self._command)
        task = asyncio.current_task()
        assert task is not None
        self._open[console] = task
        try:
            width = _cells(request.query.get("width"), 80)
            height = _cells(request.query.get("height"), 24)
            await console.start(width, height)
            await _connect(console, socket)
        finally:
            # A second cancellation must not leave a console behind.
            try:
                await asyncio.shield(console.end())
            finally:
                console.kill()
                del self._open[console]
        return socket

    @web.middleware
    async def _admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse foreign names, scripts of other pages, and whatever comes without the key."""
        name = urlsplit(f"//{request.host}").hostname or ""
        if not is_loopback(name):
            raise web.HTTPForbidden(
                text="This page is served to this machine only: open it at 127.0.0.1 or localhost."
            )

        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc != request.host:
            raise web.HTTPForbidden(text="This console takes nothing from other pages.")

        key = request.path.lstrip("/").partition("/")[0].encode("utf-8", "replace")
        if self._key and not hmac.compare_digest(key, self._key.encode()):
            raise web.HTTPForbidden(
                text="These pages give orders, so they have a key: "
                "open the whole address that covey web has printed."
            )

        response = await handler(request)
        if not response.prepared:
            for header, value in _HEADERS.items():
                response.headers[header] = value.format(host=request.host)
        return response


async def _connect(console: ConsoleProcess, socket: web.WebSocketResponse) -> None:
    """Carry a console's drawings to its page and the page's keys back, until the page closes."""
    async with asyncio.TaskGroup() as tasks:
        drawing = tasks.create_task(_draw(console, socket))
        async for message in socket:
            if message.type is WSMsgType.TEXT:
                await _pass_on(message.data, console, socket)
        drawing.cancel()


async def _file(request: web.Request) -> web.Response:
    name = request.path.rpartition("/")[2]
    return web.Response(
        text=(_FOLDER / name).read_text(encoding="utf-8"), content_type=_TYPES[name]
    )


async def _draw(console: ConsoleProcess, socket: web.WebSocketResponse) -> None:
    """Pass the console's output on to its page, and close the page after it."""
    with contextlib.suppress(ConnectionError):  # the page has gone
        async for data in console.drawings():
            await socket.send_bytes(data)
    await socket.close()


async def _pass_on(text: str, console: ConsoleProcess, socket: web.WebSocketResponse) -> None:
    """Pass on one message of the terminal in the page; a malformed one is left out."""
    try:
        match json_values(text, "a message of the page"):
            case ["stdin", str(data)]:
                console.send("D", data.encode("utf-8", "replace"))
            case ["resize", {"width": int(width), "height": int(height)}]:
                size = {"width": _cells(width, 80), "height": _cells(height, 24)}
                console.send_message({"type": "resize", **size})
            case ["ping", data]:
                await socket.send_json(["pong", data])
            case ["blur" | "focus" as kind, *_]:
                console.send_message({"type": kind})
    except (ValueError, ConnectionError):
        return


def _cells(value: object, default: int) -> int:
    """Return a size of the terminal from outside, within its limits."""
    text = str(value)
    if not text.isdecimal() or len(text) > 5:
        return default
    return min(MAX_CELLS, max(1, int(text)))


def _font_size(text: str) -> str:
    """Return a font size from outside, within its limits."""
    if not text.isdecimal() or len(text) > 3:
        return _DEFAULT_FONT_SIZE
    least, most = _FONT_SIZES
    return str(min(most, max(least, int(text))))
