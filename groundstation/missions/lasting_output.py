"""Lets a flight go on, or end in order, when its terminal or the reader of its output goes away.

A closed terminal or pipe (``| head``) makes every further line of output an error. An error in the
middle of a flight would end it without its landing and its verdict. A terminal that closes also
sends SIGHUP, which ends a program at once if nothing handles it.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any, TextIO, cast

from onboard.end_signals import termination_signals

# Tasks that the signals cancel, in the main thread's event loop; a task with two blocks is in it
# twice.
_cancelled: list[asyncio.Task[Any]] = []
_handlers_before: dict[signal.Signals, Any] = {}  # of the signals, while they cancel tasks


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
def termination_signals_as_ctrl_c() -> Iterator[None]:
    """Let the other signals that ask a flight to end do what Ctrl-C does, while the block runs."""
    previous_handlers = {}
    for number in termination_signals():
        previous_handlers[number] = signal.signal(
            number, lambda *_: signal.raise_signal(signal.SIGINT)
        )
    try:
        yield
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def cancelled_by_termination_signals() -> Iterator[None]:
    """Let these signals cancel the present task of the event loop while the block runs.

    Several tasks may have such a block, and a block may have one inside: a signal cancels all these
    tasks. The last block that ends restores what the signals did before. Only the main thread gets
    signals; in another thread the block has no effect.
    """
    task = asyncio.current_task()
    if task is None or threading.current_thread() is not threading.main_thread():
        yield
        return

    loop = asyncio.get_running_loop()
    if not _cancelled:
        for number in termination_signals():
            _handlers_before[number] = signal.getsignal(number)
            loop.add_signal_handler(number, _cancel_all)
    _cancelled.append(task)
    try:
        yield
    finally:
        _cancelled.remove(task)
        if not _cancelled:
            for number, handler in _handlers_before.items():
                loop.remove_signal_handler(number)
                if handler is not None:  # None: not set from Python
                    signal.signal(number, handler)
            _handlers_before.clear()


def _cancel_all() -> None:
    """Cancel each task with a block once."""
    for task in set(_cancelled):
        task.cancel()


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
