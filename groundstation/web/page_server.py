"""Serves the console over a web page: one process of the console for each page that is open, all on
loopback.

The terminal in the page is textual-serve's; the page around it is ours: nothing is loaded from
elsewhere. Another site's page in the same browser must not reach the fleet: names other than
loopback and foreign origins are refused. Pages that can order stand behind a key, which is the
first part of every path. A cookie would be no place for it: browsers send the cookies of one port
of this machine to all others.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import html
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from string import Template
from urllib.parse import urlsplit

import textual_serve
from aiohttp import WSCloseCode, WSMsgType, web

from groundstation.web.console_process import END_TIMEOUT_S, ConsoleProcess
from onboard.config.endpoints import is_loopback
from onboard.config.fleet import ConfigError

MAX_PAGES = 12
MAX_CELLS = 1000
_HERE = Path(__file__).parent
_STATIC = Path(textual_serve.__file__).parent / "static"
_TYPES = {"page.css": "text/css", "page.js": "text/javascript"}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; font-src 'self'; "
        "img-src 'self' data:; connect-src 'self' ws://{host}; frame-ancestors 'none'; base-uri 'none'; "
        "form-action 'none'"
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
        f"--host {host}: the console in the browser is for this machine only, since whoever opens the page sees the "
        "fleet. Leave --host out, and from another machine go through ssh: ssh -L 8000:127.0.0.1:8000 here."
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
        self._command, self._key = command, key
        self._title, self._ended = title, ended
        # with the tasks that serve their pages
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
        """Begin to serve; the address. ConfigError when the port is taken."""
        base = f"/{self._key}" if self._key else ""
        app = web.Application(middlewares=[self._admit])
        app.router.add_get(f"{base}/", self._page)
        app.router.add_get(f"{base}/ws", self._socket)
        for name in _TYPES:
            app.router.add_get(f"{base}/{name}", _file)
        app.router.add_static(f"{base}/static", _STATIC, show_index=False)
        runner = self._runner = web.AppRunner(app, access_log=None, shutdown_timeout=END_TIMEOUT_S)
        await runner.setup()
        try:
            await web.TCPSite(runner, host.strip("[]"), port).start()
        except OSError as error:
            await self.stop()
            raise ConfigError(
                f"--port {port}: {error.strerror or error}. Choose another, or 0 for any that is free."
            ) from None
        address = runner.addresses[0]
        name = f"[{address[0]}]" if ":" in str(address[0]) else address[0]
        return f"http://{name}:{address[1]}{base}/"

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
        size = request.query.get("fontsize", "")
        values = {
            "title": html.escape(self._title),
            "ended": html.escape(self._ended),
            "socket": html.escape(f"ws://{request.host}{request.path}ws"),
            "font_size": str(min(60, max(6, int(size))))
            if size.isdecimal() and len(size) < 4
            else "16",
        }
        text = Template((_HERE / "page.html").read_text(encoding="utf-8")).substitute(values)
        return web.Response(text=text, content_type="text/html")

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        pipe = web.WebSocketResponse(timeout=END_TIMEOUT_S, heartbeat=15.0, max_msg_size=65_536)
        await pipe.prepare(request)
        if self._is_stopping or len(self._open) >= MAX_PAGES:
            await pipe.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many pages are open")
            return pipe
        console, task = ConsoleProcess(self._command), asyncio.current_task()
        assert task is not None
        self._open[console] = task
        try:
            await console.start(
                _cells(request.query.get("width"), 80), _cells(request.query.get("height"), 24)
            )
            async with asyncio.TaskGroup() as tasks:
                drawing = tasks.create_task(_draw(console, pipe))
                async for message in pipe:
                    if message.type is WSMsgType.TEXT:
                        await _pass_on(message.data, console, pipe)
                drawing.cancel()
        finally:
            try:
                await asyncio.shield(console.end())
            finally:
                console.kill()
                del self._open[console]
        return pipe

    @web.middleware
    async def _admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse another name for this machine, a script of another page, and whatever comes
        without the key.
        """
        name = urlsplit(f"//{request.host}").hostname or ""
        origin = request.headers.get("Origin")
        if not is_loopback(name):
            raise web.HTTPForbidden(
                text="This page is served to this machine only: open it at 127.0.0.1 or localhost."
            )
        if origin is not None and urlsplit(origin).netloc != request.host:
            raise web.HTTPForbidden(text="This console takes nothing from other pages.")
        given = request.path.lstrip("/").partition("/")[0]
        if self._key and not hmac.compare_digest(
            given.encode("utf-8", "replace"), self._key.encode()
        ):
            raise web.HTTPForbidden(
                text="These pages give orders, so they have a key: open the whole address that covey web has printed."
            )
        response = await handler(request)
        if not response.prepared:
            for header, value in _HEADERS.items():
                response.headers[header] = value.format(host=request.host)
        return response


async def _file(request: web.Request) -> web.Response:
    name = request.path.rpartition("/")[2]
    return web.Response(text=(_HERE / name).read_text(encoding="utf-8"), content_type=_TYPES[name])


async def _draw(console: ConsoleProcess, pipe: web.WebSocketResponse) -> None:
    """Pass the console's output on to its page, and close the page after it; a page that has gone
    ends that.
    """
    with contextlib.suppress(ConnectionError):
        async for data in console.drawings():
            await pipe.send_bytes(data)
    await pipe.close()


async def _pass_on(text: str, console: ConsoleProcess, pipe: web.WebSocketResponse) -> None:
    """Pass on one message of the terminal in the page; a malformed one is left out."""
    try:
        match json.loads(text):
            case ["stdin", str(data)]:
                console.send("D", data.encode("utf-8", "replace"))
            case ["resize", {"width": int(width), "height": int(height)}]:
                size = {"width": _cells(width, 80), "height": _cells(height, 24)}
                console.send_message({"type": "resize", **size})
            case ["ping", data]:
                await pipe.send_json(["pong", data])
            case ["blur" | "focus" as kind, *_]:
                console.send_message({"type": kind})
    except (ValueError, ConnectionError):
        return


def _cells(value: object, default: int) -> int:
    text = str(value)
    return min(MAX_CELLS, max(1, int(text))) if text.isdecimal() and len(text) < 6 else default
