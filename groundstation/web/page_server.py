"""Serves the page of a fleet, and the WebSocket behind it, to browsers of this machine.

The server listens on loopback only, and another site's page in the same browser must not reach the
fleet: host names other than loopback and foreign origins are refused. Nothing is loaded from
elsewhere.

Pages that can give orders are protected by a key, which is the first part of every path. A cookie
would not keep the key safe: browsers send the cookies of one port of this machine to all others.

A page can send a few kinds of messages, each with bounds, see :func:`obey`; all others are ignored.
A server that only watches ignores all messages of its pages.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import html
from collections.abc import Awaitable, Callable, Mapping
from importlib.resources import files
from string import Template
from urllib.parse import urlsplit

from aiohttp import WSCloseCode, WSMsgType, web

from groundstation.scene.ground_tiles import GroundTile, GroundTiles
from groundstation.scene.static_files import text_of
from groundstation.web.live_feed import LiveFeed, TooSlow
from groundstation.web.order_cards import MAX_LINE
from onboard.config.endpoints import is_loopback
from onboard.config.file_reading import json_values
from onboard.config.fleet import ConfigError

MAX_PAGES = 50
# Longest message of a page [bytes]. The longest line fits in, in any letters: JSON may write one as
# up to 12 bytes.
MAX_MESSAGE_BYTES = 12 * MAX_LINE + 1024
_HEARTBEAT_S = 15.0
_CLOSE_S = 3.0
_SHARED_SCRIPTS = ("elements.js", "colours.js", "camera.js", "scene.js", "ground.js")
_OWN_SCRIPTS = ("live_scene.js", "live.js")
_SHARED_STYLE = "page.css"
_OWN_STYLE = "live.css"
# extension of a file -> its type
_TYPES = {"css": "text/css", "js": "text/javascript"}
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data:; connect-src 'self' ws://{host}; frame-ancestors 'none'; "
        "base-uri 'none'; form-action 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

_closings: set[asyncio.Future[bool]] = set()  # keeps running tasks alive, see _close_after


def require_loopback(host: str) -> str:
    """Return the host if only this machine can reach it.

    Raises:
        ConfigError: other machines can reach it.
    """
    if is_loopback(host):
        return host
    raise ConfigError(
        f"--host {host}: the page is for this machine only, since whoever opens it sees the fleet. "
        "Leave --host out, and from another machine go through ssh: "
        "ssh -L 8000:127.0.0.1:8000 here."
    )


class PageServer:
    """Serves one page at an address of this machine.

    Args:
        title: the page's title.
        feed: the fleet that the page shows; None serves ``page`` alone.
        page: the HTML of a finished page, which is served instead of a fleet's.
        ground: pictures of the ground, which the page loads by their numbers.
        key: the first part of every path, without which nothing is served; empty needs no key.
    """

    def __init__(
        self,
        *,
        title: str,
        feed: LiveFeed | None = None,
        page: str = "",
        ground: GroundTiles | None = None,
        key: str = "",
    ) -> None:
        self._title = title
        self._feed = feed
        self._finished_page = page
        self._ground = ground
        self._key = key
        self._sockets: set[web.WebSocketResponse] = set()
        self._runner: web.AppRunner | None = None
        self._is_stopping = False

    async def start(self, host: str, port: int) -> str:
        """Begin to serve.

        Args:
            host: a loopback address.
            port: the port; 0 takes any free one.

        Returns:
            The address of the page.

        Raises:
            ConfigError: the port cannot be opened.
        """
        base = ""  # the part before every path
        if self._key:
            base = f"/{self._key}"
        app = web.Application(middlewares=[self._admit])
        app.router.add_get(f"{base}/", self._page)
        if self._feed is not None:
            app.router.add_get(f"{base}/ws", self._socket)
            app.router.add_get(f"{base}/files/{{name:.+}}", _file)
            app.router.add_get(f"{base}/tiles/{{number:[0-9]{{1,4}}}}", self._tile)

        runner = web.AppRunner(app, access_log=None, shutdown_timeout=_CLOSE_S)
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

        opened_host, opened_port, *_ = runner.addresses[0]
        if ":" in str(opened_host):  # IPv6
            opened_host = f"[{opened_host}]"
        return f"http://{opened_host}:{opened_port}{base}/"

    async def stop(self) -> None:
        """Close all pages; a second call does nothing."""
        self._is_stopping = True
        for socket in list(self._sockets):
            with contextlib.suppress(ConnectionError, TimeoutError):
                await socket.close(code=WSCloseCode.GOING_AWAY, message=b"covey web has ended")
        if self._runner is not None:
            await self._runner.cleanup()
            self._runner = None

    async def _page(self, request: web.Request) -> web.Response:
        if self._finished_page:
            return web.Response(text=self._finished_page, content_type="text/html")

        scripts = "\n".join(
            f'<script src="files/{name}" defer></script>'
            for name in (*_SHARED_SCRIPTS, *_OWN_SCRIPTS)
        )
        styles = "\n".join(
            f'<link rel="stylesheet" href="files/{name}">' for name in (_SHARED_STYLE, _OWN_STYLE)
        )
        page = Template(_own_text("live.html"))
        text = page.substitute(
            title=html.escape(self._title), scripts=scripts, styles=styles, max_line=MAX_LINE
        )
        return web.Response(text=text, content_type="text/html")

    async def _tile(self, request: web.Request) -> web.Response:
        """Return one picture of the ground."""
        tiles: tuple[GroundTile, ...] = ()
        if self._ground is not None:
            tiles = self._ground.tiles
        number = int(request.match_info["number"])
        if number >= len(tiles):
            raise web.HTTPNotFound(text="There is no such tile.")
        return web.Response(body=tiles[number].png, content_type="image/png")

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        """Serve one page for as long as it is open."""
        socket = web.WebSocketResponse(
            timeout=_CLOSE_S, heartbeat=_HEARTBEAT_S, max_msg_size=MAX_MESSAGE_BYTES
        )
        await socket.prepare(request)
        if self._is_stopping or len(self._sockets) >= MAX_PAGES:
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many pages are open")
            return socket

        assert self._feed is not None
        page = self._feed.open()
        self._sockets.add(socket)
        sending = asyncio.create_task(page.send_all(socket.send_str))
        sending.add_done_callback(lambda task: _close_after(task, socket))
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    await obey(message.data, self._feed)
                    # many messages may have arrived at once: all pages get their cards in between
                    await asyncio.sleep(0)
        finally:
            self._sockets.discard(socket)
            self._feed.close(page)
            sending.cancel()
        return socket

    @web.middleware
    async def _admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse foreign host names, scripts of other pages, and requests without the key."""
        if not is_loopback(_host_name(request.host)):
            raise web.HTTPForbidden(
                text="This page is served to this machine only: open it at 127.0.0.1 or localhost."
            )

        origin = request.headers.get("Origin")
        if origin is not None and not _is_of_host(origin, request.host):
            raise web.HTTPForbidden(text="This page takes nothing from other pages.")

        key, _, _ = request.path.lstrip("/").partition("/")
        given_key = key.encode("utf-8", "replace")
        if self._key and not hmac.compare_digest(given_key, self._key.encode()):
            raise web.HTTPForbidden(
                text="These pages give orders, so they have a key: "
                "open the whole address that covey web has printed."
            )

        response = await handler(request)
        if not response.prepared and not self._finished_page:
            for header, value in _HEADERS.items():
                response.headers[header] = value.format(host=request.host)
        return response


def _host_name(host: str) -> str:
    """Return the name in a Host header, without its port; empty if there is none."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _is_of_host(origin: str, host: str) -> bool:
    """Return whether an Origin header names a page of this host."""
    try:
        return urlsplit(origin).netloc == host
    except ValueError:
        return False


def _close_after(task: asyncio.Task[None], socket: web.WebSocketResponse) -> None:
    """Close a socket whose page has gone or is too slow, once sending to it has ended."""
    if task.cancelled():
        return
    error = task.exception()
    if isinstance(error, (TooSlow, ConnectionError)) and not socket.closed:
        closing = asyncio.ensure_future(socket.close(code=WSCloseCode.POLICY_VIOLATION))
        _closings.add(closing)
        closing.add_done_callback(_closings.discard)


async def obey(text: str, feed: LiveFeed) -> None:
    """Carry out a message of a page; a message of an unknown form is ignored.

    Args:
        text: the message, JSON.
        feed: the feed whose cards and alarms it makes or changes; without cards it only watches.
    """
    cards = feed.cards
    if cards is None:
        return
    try:
        values = json_values(text, "a message of the page")
    except ConfigError:
        return
    if not isinstance(values, Mapping):
        return

    match dict(values):
        case {"do": "order", "text": str(order)}:
            # half of a pair of surrogates cannot be sent back to the pages
            await cards.take(order.encode("utf-8", "replace").decode("utf-8"))
        case {"do": "urgent", "verb": str(verb)}:
            cards.urgent(verb)
        case {"do": "stop_countdown"}:
            cards.missions.stop_countdown()
        case {"do": "confirm", "number": int(number)}:
            cards.confirm(number)
        case {"do": "drop", "number": int(number)}:
            cards.drop(number)
        case {"do": "acknowledge", "kind": str(kind), "subject": str(subject)}:
            feed.acknowledge(kind, subject)


async def _file(request: web.Request) -> web.Response:
    """Return a script or a style of the page."""
    name = request.match_info["name"]
    if name in (*_OWN_SCRIPTS, _OWN_STYLE):
        text = _own_text(name)
    elif name in (*_SHARED_SCRIPTS, _SHARED_STYLE):
        text = text_of(name)
    else:
        raise web.HTTPNotFound(text="There is no such file.")
    _, _, extension = name.rpartition(".")
    return web.Response(text=text, content_type=_TYPES[extension])


def _own_text(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
