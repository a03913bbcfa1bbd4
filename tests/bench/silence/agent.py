"""A real agent that can be made to hang: SIGUSR1 blocks one part of it for some seconds.

The hooks are put around the agent from outside and live in the tests: the program that flies has
none. ``python -m tests.bench.silence.agent PART SECONDS --fleet ... --vehicle ...``
"""

from __future__ import annotations

import ctypes
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from onboard.agent import loop
from onboard.agent.main import main
from onboard.bus import session
from onboard.px4.mavsdk_link import Px4Link

PARTS = ("nothing", "loop", "interpreter", "autopilot", "bus", "executors")


class Hang:
    """Blocks a part when asked.

    Args:
        part: loop: the event loop's thread sleeps. interpreter: a thread of C code keeps Python's
            lock, so that no other Python thread runs. autopilot, bus: the threads on which MAVSDK's
            or Zenoh's messages arrive. executors: the threads for blocking calls.
    """

    def __init__(self, part: str, seconds: float) -> None:
        self.part = part
        self.seconds = seconds
        self.agent: loop.AgentProcess | None = None
        self._until_s = 0.0

    def begin(self, *_: object) -> None:
        """The signal's handler; runs on the loop's thread."""
        if self.part == "loop":
            time.sleep(self.seconds)
        elif self.part == "interpreter":
            hold = ctypes.PyDLL(None).usleep  # PyDLL: the lock is kept during the call
            threading.Thread(target=hold, args=(round(self.seconds * 1e6),), daemon=True).start()
        elif self.part == "executors":
            assert self.agent is not None
            for block in (self.agent._upkeep._blocking, self.agent._executor.reliable):
                block.submit(time.sleep, self.seconds)
        else:
            self._until_s = time.monotonic() + self.seconds

    def around(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """``function``, held up while it is this part's turn to hang, on whatever thread it is
        called.
        """

        def called(*args: Any) -> Any:
            if self._until_s and self.part == part:
                time.sleep(max(0.0, self._until_s - time.monotonic()))
            return function(*args)

        return called


def install(hang: Hang) -> None:
    """Put the hooks around the agent's parts."""
    plain_init = loop.AgentProcess.__init__
    plain_callback = session._callback
    plain_receive = Px4Link._receive

    def init(self: loop.AgentProcess, *args: Any, **named: Any) -> None:
        plain_init(self, *args, **named)
        hang.agent = self

    loop.AgentProcess.__init__ = init  # type: ignore[method-assign]
    session._callback = lambda function, *rest: plain_callback(hang.around("bus", function), *rest)
    received = hang.around("autopilot", plain_receive)
    Px4Link._receive = lambda self, *args: received(self, *args)  # type: ignore[method-assign]
    signal.signal(signal.SIGUSR1, hang.begin)


if __name__ == "__main__":
    install(Hang(sys.argv[1], float(sys.argv[2])))
    sys.exit(main(sys.argv[3:]))
