"""Lets a flight go on, or end in order, when its terminal or the reader of its output goes away.

A closed terminal or pipe (``| head``) makes every further line of output an error. An error in the
middle of a flight would end it without its landing and its verdict. A terminal that closes also
sends SIGHUP, which ends a program at once if nothing handles it.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from typing import Any, TextIO, cast

from onboard.end_signals import end_signals


@contextlib.contextmanager
def lasting_output(dropped: type[OSError] = OSError) -> Iterator[None]:
    """Drop the output of the block that nobody can read any more, instead of raising an error.

    Args:
        dropped: error after which output is dropped. A BrokenPipeError means that its reader has
            ended; others, as of a full disk, are raised then.
    """
    before = sys.stdout, sys.stderr
    sys.stdout = cast("TextIO", _LastingStream(sys.stdout, dropped))
    sys.stderr = cast("TextIO", _LastingStream(sys.stderr, dropped))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


@contextlib.contextmanager
def end_signals_as_ctrl_c() -> Iterator[None]:
    """Let the other signals that ask a flight to end do what Ctrl-C does, while the block runs."""
    previous_handlers = {}
    for number in end_signals():
        previous_handlers[number] = signal.signal(
            number, lambda *_: signal.raise_signal(signal.SIGINT)
        )
    try:
        yield
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)


class _LastingStream:
    """A stream that goes to the null device once it cannot be written any more.

    Args:
        stream: standard output or standard error.
        dropped: error after which output is dropped.
    """

    def __init__(self, stream: TextIO, dropped: type[OSError]) -> None:
        self._stream = stream
        self._dropped = dropped

    def write(self, text: str) -> int:
        """Write a text, or drop it."""
        try:
            return self._stream.write(text)
        except self._dropped:
            self._drop_further()
            return len(text)

    def flush(self) -> None:
        """Write what waits, or drop it."""
        try:
            self._stream.flush()
        except self._dropped:
            self._drop_further()

    def _drop_further(self) -> None:
        null_device = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null_device, self._stream.fileno())
        os.close(null_device)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
