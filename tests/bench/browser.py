"""A headless Chromium that a benchmark steers: evaluates scripts, presses keys, takes pictures.

It is spoken to by Chrome's DevTools protocol, JSON over a WebSocket of loopback.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import itertools
import shutil
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp

OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
_START_S = 60.0
_MAX_BYTES = 64_000_000  # of a message: a picture


class Browser:
    """One page of a browser.

    Args:
        socket: of the page's DevTools.
    """

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket = socket
        self._numbers = itertools.count(1)

    async def call(self, method: str, **values: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        number = next(self._numbers)
        await self._socket.send_json({"id": number, "method": method, "params": values})
        while True:
            message = await self._socket.receive_json()
            if message.get("id") != number:
                continue
            if "error" in message:
                raise RuntimeError(f"{method}: {message['error']['message']}")
            result: dict[str, Any] = message["result"]
            return result

    async def evaluate(self, script: str) -> Any:
        """Return the value of an expression of the page; a promise is waited for."""
        result = await self.call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in result:
            raise RuntimeError(str(result["exceptionDetails"]))
        return result["result"].get("value")

    async def press(self, key: str, code: int) -> None:
        """Press and release a key."""
        for kind in ("rawKeyDown", "keyUp"):
            await self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code
            )

    async def picture(self, path: Path) -> None:
        """Write a picture of the page."""
        result = await self.call("Page.captureScreenshot", format="png")
        await asyncio.to_thread(path.write_bytes, base64.b64decode(result["data"]))


@contextlib.asynccontextmanager
async def browser_at(address: str, size: str) -> AsyncIterator[Browser | None]:
    """Open a page in a browser of its own; None where there is no Chromium.

    Args:
        address: of the page.
        size: of the window: WIDTH,HEIGHT.
    """
    program = shutil.which("chromium")
    if program is None:
        yield None
        return

    with tempfile.TemporaryDirectory(prefix="covey-page-", ignore_cleanup_errors=True) as profile:
        process = await asyncio.create_subprocess_exec(
            program,
            *OPTIONS,
            f"--user-data-dir={profile}",
            f"--window-size={size}",
            "--remote-debugging-port=0",
            address,
            stderr=asyncio.subprocess.DEVNULL,
        )
        try:
            port = await _port_of(Path(profile))
            async with aiohttp.ClientSession() as session:
                tools = await _tools_of(session, port, address)
                async with session.ws_connect(tools, max_msg_size=_MAX_BYTES) as socket:
                    yield Browser(socket)
        finally:
            process.terminate()
            await process.wait()


async def _port_of(profile: Path) -> int:
    """Return the port of the browser's DevTools, once it has written it down."""
    async with asyncio.timeout(_START_S):
        while True:
            with contextlib.suppress(FileNotFoundError, IndexError, ValueError):
                return int((profile / "DevToolsActivePort").read_text().split()[0])
            await asyncio.sleep(0.1)


async def _tools_of(session: aiohttp.ClientSession, port: int, address: str) -> str:
    """Return the address of a page's DevTools, once the page is open."""
    async with asyncio.timeout(_START_S):
        while True:
            async with session.get(f"http://127.0.0.1:{port}/json/list") as response:
                for page in await response.json():
                    if page.get("url") == address:
                        return str(page["webSocketDebuggerUrl"])
            await asyncio.sleep(0.1)
