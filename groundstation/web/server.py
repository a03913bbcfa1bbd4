"""Serves the console over a web page: one process of the console for each page that is open, all on loopback.

The terminal in the page is textual-serve's; the page around it is ours: nothing is loaded from elsewhere. Another
site's page in the same browser must not reach the fleet: names other than loopback and foreign origins are refused.
"""

from __future__ import annotations

import asyncio
import html
import ipaddress
import json
import shlex
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from string import Template
from urllib.parse import urlsplit

import textual_serve
from aiohttp import WSCloseCode, WSMsgType, web
from textual_serve.app_service import AppService
from textual_serve.download_manager import DownloadManager

from onboard.config.fleet import ConfigError

MAX_PAGES = 12
MAX_CELLS = 1000
END_TIMEOUT_S = 3.0
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
    """The host, if only this machine can reach it; ConfigError in words otherwise."""
    if is_loopback(host):
        return host
    raise ConfigError(
        f"--host {host}: the console in the browser is for this machine only, since whoever opens the page sees the "
        "fleet. Leave --host out, and from another machine go through ssh: ssh -L 8000:127.0.0.1:8000 here."
    )


def is_loopback(host: str) -> bool:
    """Whether a host name or address means this machine and nothing else."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


class ConsoleServer:
    """Pages of one command.

    Args:
        words: the console's command line, after ``covey``. title: of the page. ended: what the page says afterwards.
    """

    def __init__(self, words: list[str], *, title: str, ended: str) -> None:
        self._command = "exec " + shlex.join([sys.executable, "-m", "groundstation", *words])
        self._title, self._ended = title, ended
        self._downloads = DownloadManager()
        self._open: set[AppService] = set()
        self._runner: web.AppRunner | None = None

    @property
    def pages(self) -> int:
        """Number of open pages."""
        return len(self._open)

    async def start(self, host: str, port: int) -> str:
        """Begin to serve; the address. ConfigError when the port is taken."""
        app = web.Application(middlewares=[_guarded])
        app.router.add_get("/", self._page)
        app.router.add_get("/ws", self._socket)
        for name in _TYPES:
            app.router.add_get(f"/{name}", _file)
        app.router.add_static("/static", _STATIC, show_index=False)
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
        return f"http://{name}:{address[1]}/"

    async def stop(self) -> None:
        """End all pages and their consoles."""
        await asyncio.gather(*(_end(service) for service in list(self._open)))
        if self._runner is not None:
            await self._runner.cleanup()

    async def _page(self, request: web.Request) -> web.Response:
        size = request.query.get("fontsize", "")
        values = {
            "title": html.escape(self._title),
            "ended": html.escape(self._ended),
            "socket": html.escape(f"ws://{request.host}/ws"),
            "font_size": str(min(60, max(6, int(size)))) if size.isdecimal() and len(size) < 4 else "16",
        }
        text = Template((_HERE / "page.html").read_text(encoding="utf-8")).substitute(values)
        return web.Response(text=text, content_type="text/html")

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        pipe = web.WebSocketResponse(heartbeat=15.0, max_msg_size=65_536)
        await pipe.prepare(request)
        if len(self._open) >= MAX_PAGES:
            await pipe.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many pages are open")
            return pipe

        async def close() -> None:
            await pipe.close()

        service = AppService(
            self._command,
            write_bytes=pipe.send_bytes,
            write_str=pipe.send_str,
            close=close,
            download_manager=self._downloads,
        )
        self._open.add(service)
        try:
            await service.start(_cells(request.query.get("width"), 80), _cells(request.query.get("height"), 24))
            async for message in pipe:
                if message.type is WSMsgType.TEXT:
                    await _pass_on(message.data, service, pipe)
        finally:
            await asyncio.shield(_end(service))
            self._open.discard(service)
        return pipe


@web.middleware
async def _guarded(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Refuse what only pretends to be this machine: another name for it, or a script of another page."""
    name = urlsplit(f"//{request.host}").hostname or ""
    origin = request.headers.get("Origin")
    if not is_loopback(name):
        raise web.HTTPForbidden(text="This page is served to this machine only: open it at 127.0.0.1 or localhost.")
    if origin is not None and urlsplit(origin).netloc != request.host:
        raise web.HTTPForbidden(text="This console takes nothing from other pages.")
    response = await handler(request)
    if not response.prepared:
        for header, value in _HEADERS.items():
            response.headers[header] = value.format(host=request.host)
    return response


async def _file(request: web.Request) -> web.Response:
    name = request.path.strip("/")
    return web.Response(text=(_HERE / name).read_text(encoding="utf-8"), content_type=_TYPES[name])


async def _pass_on(text: str, service: AppService, pipe: web.WebSocketResponse) -> None:
    """One message of the terminal in the page; what is none is left out."""
    try:
        match json.loads(text):
            case ["stdin", str(data)]:
                await service.send_bytes(data.encode("utf-8", "replace"))
            case ["resize", {"width": int(width), "height": int(height)}]:
                await service.set_terminal_size(_cells(width, 80), _cells(height, 24))
            case ["ping", data]:
                await pipe.send_json(["pong", data])
            case ["blur", *_]:
                await service.blur()
            case ["focus", *_]:
                await service.focus()
    except (ValueError, ConnectionError):
        return


async def _end(service: AppService) -> None:
    """Ask the console to leave, and end it if it does not."""
    try:
        async with asyncio.timeout(END_TIMEOUT_S):
            await service.stop()
    except (TimeoutError, ConnectionError):
        process = service._process
        if process is not None and process.returncode is None:
            process.kill()


def _cells(value: object, default: int) -> int:
    text = str(value)
    return min(MAX_CELLS, max(1, int(text))) if text.isdecimal() and len(text) < 6 else default
