"""The signals that ask a process to end in order."""

from __future__ import annotations

import signal


def end_signals() -> tuple[signal.Signals, ...]:
    """Return SIGINT, which Ctrl-C sends, and :func:`termination_signals`."""
    return signal.SIGINT, *termination_signals()


def termination_signals() -> tuple[signal.Signals, ...]:
    """Return SIGTERM, and SIGHUP, which a process gets when its terminal closes.

    SIGHUP is not among them if the process was started so that it outlives its terminal (nohup).
    """
    if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        return (signal.SIGTERM,)
    return signal.SIGTERM, signal.SIGHUP
