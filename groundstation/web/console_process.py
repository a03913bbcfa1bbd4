"""One console for one page: a process that draws into a pipe.

It never outlives its page or its server. Its protocol is that of Textual's web driver: packets of
one letter (D for data, M for a message in JSON), a length of four bytes, and so many bytes.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
from collections.abc import AsyncIterator, Mapping
from typing import Literal

END_TIMEOUT_S = 3.0
_PRELUDE = b"__GANGLION__\n"  # of Textual's web driver; lines before it are no packets
_PRELUDE_LINES = 10
_HEAD_BYTES = 5  # of a packet: its letter and its length
_INPUT_LIMIT_BYTES = 65_536

# The kernel ends the console when its server is gone, however that ended. A console cannot request
# this by itself while it starts, so a small interpreter requests it and then becomes the console.
_END_WITH_SERVER = (
    "import ctypes, os, signal, sys\n"
    "ctypes.CDLL(None).prctl(1, signal.SIGKILL)\n"  # PR_SET_PDEATHSIG
    "if os.getppid() == int(sys.argv[1]): os.execv(sys.argv[2], sys.argv[2:])\n"
)


class ConsoleProcess:
    """A console's process, its input and its output.

    Args:
        command: program with its arguments.
    """

    def __init__(self, command: list[str]) -> None:
        if sys.platform.startswith("linux"):
            command = [sys.executable, "-ISc", _END_WITH_SERVER, str(os.getpid()), *command]
        self._command = command
        self._process: asyncio.subprocess.Process | None = None

    @property
    def pid(self) -> int | None:
        """Process id; None before the start."""
        return None if self._process is None else self._process.pid

    async def start(self, width: int, height: int) -> None:
        """Start the console with a size in cells."""
        environment = {
            **os.environ,
            "TEXTUAL_DRIVER": "textual.drivers.web_driver:WebDriver",
            "TEXTUAL_FPS": "60",
            "TEXTUAL_COLOR_SYSTEM": "truecolor",
            "TERM_PROGRAM": "textual",
            "COLUMNS": str(width),
            "ROWS": str(height),
        }
        self._process = await asyncio.create_subprocess_exec(
            *self._command,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            process_group=0,  # a Ctrl-C at the server's terminal is the server's
            env=environment,
        )

    async def drawings(self) -> AsyncIterator[bytes]:
        """Yield the bytes for the page's terminal, until the console ends."""
        assert self._process is not None
        output = self._process.stdout
        assert output is not None

        for _ in range(_PRELUDE_LINES):
            if await output.readline() == _PRELUDE:
                break

        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):  # it has ended
            while True:
                head = await output.readexactly(_HEAD_BYTES)
                kind = head[:1]
                payload = await output.readexactly(int.from_bytes(head[1:], "big"))
                if kind == b"D":
                    yield payload
                elif kind == b"M" and b'"exit"' in payload:
                    return

    def send(self, kind: Literal["D", "M"], payload: bytes) -> None:
        """Send one packet to the console.

        One that has ended, or has not read for long, gets nothing.
        """
        assert self._process is not None
        pipe = self._process.stdin
        assert pipe is not None

        has_room = pipe.transport.get_write_buffer_size() < _INPUT_LIMIT_BYTES
        if not pipe.is_closing() and has_room:
            pipe.write(kind.encode() + len(payload).to_bytes(4, "big") + payload)

    def send_message(self, message: Mapping[str, object]) -> None:
        """Send a message of the page: resize, focus, blur or quit."""
        self.send("M", json.dumps(message).encode())

    async def end(self) -> None:
        """Ask the console to leave, and kill it if it does not; it is gone afterwards.

        Nobody may iterate over :meth:`drawings` meanwhile.
        """
        if self._process is None:
            return

        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(END_TIMEOUT_S):
                self.send_message({"type": "quit"})
                await self._wait()

        self.kill()
        await self._wait()

    def kill(self) -> None:
        """End it at once; nothing when it has ended."""
        process = self._process
        if process is not None and process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)

    async def _wait(self) -> None:
        """Wait for the end of the process.

        Its output is read meanwhile: a process that cannot write cannot leave.
        """
        assert self._process is not None
        assert self._process.stdout is not None
        while await self._process.stdout.read(65_536):
            pass
        await self._process.wait()
