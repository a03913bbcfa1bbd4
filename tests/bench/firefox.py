"""A headless Firefox that a test steers: evaluates scripts, takes pictures, collects errors.

It is spoken to by WebDriver BiDi, JSON over a WebSocket of loopback. A headless Firefox has no
WebGL2 on a computer without a graphics card, so a page must draw its scene without it there.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import re
import shutil
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp

_START_S = 60.0
_MAX_BYTES = 64_000_000  # of a message: a picture
_ADDRESS = re.compile(r"WebDriver BiDi listening on (ws://127\.0\.0\.1:\d+)")
_PREFERENCES = """
user_pref("remote.active-protocols", 1);
user_pref("app.update.enabled", false);
user_pref("datareporting.policy.dataSubmissionEnabled", false);
user_pref("network.captive-portal-service.enabled", false);
user_pref("network.connectivity-service.enabled", false);
"""


class Firefox:
    """One page of a Firefox.

    Args:
        socket: of its session.
    """

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)
        self._page = ""
        self.errors: list[str] = []  # of the page's scripts, and of its security policy

    async def open(self, address: str) -> None:
        """Open an address and wait until the page is loaded."""
        await self._call("session.new", capabilities={})
        await self._call("session.subscribe", events=["log.entryAdded"])
        tree = await self._call("browsingContext.getTree")
        self._page = tree["contexts"][0]["context"]
        await self._call(
            "browsingContext.navigate", context=self._page, url=address, wait="complete"
        )

    async def resize(self, width_px: int, height_px: int) -> None:
        """Give the page another size."""
        await self._call(
            "browsingContext.setViewport",
            context=self._page,
            viewport={"width": width_px, "height": height_px},
        )

    async def evaluate(self, script: str) -> Any:
        """Return the value of an expression of the page: a text, a number or a truth value."""
        result = await self._call(
            "script.evaluate", expression=script, target={"context": self._page}, awaitPromise=True
        )
        if result["type"] != "success":
            raise RuntimeError(str(result["exceptionDetails"]))
        return result["result"].get("value")

    async def picture(self, path: Path) -> None:
        """Write a picture of the page."""
        result = await self._call("browsingContext.captureScreenshot", context=self._page)
        await asyncio.to_thread(path.write_bytes, base64.b64decode(result["data"]))

    async def _call(self, method: str, **values: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        number = next(self._numbers)
        await self._socket.send_json({"id": number, "method": method, "params": values})
        while True:
            message = await self._socket.receive_json()
            if message.get("method") == "log.entryAdded":
                self._note(message["params"])
            if message.get("id") != number:
                continue
            if message["type"] == "error":
                raise RuntimeError(f"{method}: {message['message']}")
            result: dict[str, Any] = message["result"]
            return result

    def _note(self, entry: dict[str, Any]) -> None:
        """Keep what the page logs as an error."""
        if entry.get("level") == "error":
            self.errors.append(str(entry.get("text")))


@contextlib.asynccontextmanager
async def firefox_at(address: str) -> AsyncIterator[Firefox | None]:
    """Open a page in a Firefox of its own; None where there is no Firefox.

    Args:
        address: of the page.
    """
    program = shutil.which("firefox") or shutil.which("firefox-esr")
    if program is None:
        yield None
        return

    with tempfile.TemporaryDirectory(prefix="covey-page-", ignore_cleanup_errors=True) as profile:
        await asyncio.to_thread((Path(profile) / "user.js").write_text, _PREFERENCES)
        process = await asyncio.create_subprocess_exec(
            program,
            "--headless",
            "--no-remote",
            "--profile",
            profile,
            "--remote-debugging-port",
            "0",
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
        )
        try:
            socket_address = await _socket_of(process)
            async with (
                aiohttp.ClientSession() as session,
                session.ws_connect(f"{socket_address}/session", max_msg_size=_MAX_BYTES) as socket,
            ):
                browser = Firefox(socket)
                await browser.open(address)
                yield browser
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
            await process.wait()


async def _socket_of(process: asyncio.subprocess.Process) -> str:
    """Return the address of the browser's WebSocket, once the browser has printed it."""
    assert process.stderr is not None
    async with asyncio.timeout(_START_S):
        while True:
            line = (await process.stderr.readline()).decode(errors="replace")
            if line == "":
                raise RuntimeError("Firefox ended before it listened.")
            found = _ADDRESS.search(line)
            if found is not None:
                return found.group(1)
