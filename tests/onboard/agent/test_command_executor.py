"""A setpoint leaves within its tick, or not at all."""

from __future__ import annotations

import time
from typing import Any, cast

from onboard import agent_commands
from onboard.agent.command_executor import CommandExecutor
from onboard.types import AttitudeSetpoint


class Link:
    """Keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[AttitudeSetpoint] = []

    def send_attitude(self, setpoint: AttitudeSetpoint) -> None:
        self.sent.append(setpoint)


def test_a_setpoint_that_comes_too_late_is_not_sent_and_told() -> None:
    link = Link()
    dropped: list[int] = []
    executor = CommandExecutor(
        name="mav0",
        others=[],
        link=cast(Any, link),
        bus=cast(Any, None),
        inbox=cast(Any, None),
        on_exit=lambda: None,
        on_dropped=lambda: dropped.append(1),
    )
    command = agent_commands.SendAttitude(AttitudeSetpoint((1.0, 0.0, 0.0, 0.0), 0.5))
    executor.tick_ns = time.monotonic_ns()
    executor.execute([command])
    assert (len(link.sent), dropped) == (1, [])

    executor.tick_ns = time.monotonic_ns() - 1_000_000_000
    executor.execute([command])
    assert (len(link.sent), dropped) == (1, [1])
    executor.stop()
