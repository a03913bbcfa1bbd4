"""Telemetry that an agent passes on to the others, and how often it listens to each of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, cast

import msgspec
import pytest

from onboard import agent_commands
from onboard.agent.command_executor import CommandExecutor
from onboard.agent.inbox import Inbox
from onboard.agent.telemetry_decimation import TelemetryDecimation
from onboard.bus.schema import Telemetry
from onboard.bus.topics import Topic
from tests.onboard.agent.rig import Rig
from tests.sitl.square_fleets import square_fleet

_TENTH_NS = 100_000_000


@pytest.fixture(scope="module")
def telemetry() -> Telemetry:
    rig = Rig()
    rig.run(1.0)
    assert rig.telemetry is not None
    return rig.telemetry


def _told(telemetry: Telemetry, tenths: Iterable[int], **changes: Any) -> list[int]:
    brief = TelemetryDecimation()
    assert all(
        brief.is_due(msgspec.structs.replace(telemetry, stamp_ns=tenth * _TENTH_NS))
        for tenth in range(-3, 1)
    )
    return [
        tenth
        for tenth in tenths
        if brief.is_due(
            msgspec.structs.replace(
                telemetry, stamp_ns=tenth * _TENTH_NS, **(changes if tenth >= 2 else {})
            )
        )
    ]


def test_without_news_the_others_hear_it_twice_a_second(telemetry: Telemetry) -> None:
    assert _told(telemetry, range(1, 21)) == [5, 10, 15, 20]


@pytest.mark.parametrize(
    "changes",
    [
        {"state": "flying"},
        {"is_airborne": True},
        {"is_position_valid": False},
        {"goal_position_enu_m": (9.0, 9.0, 1.0)},
        {"goal_position_enu_m": (math.nan, 0.0, 0.0)},
        {"order_id": "another"},
        {"doubles": ("mav2",)},
        {"config_hash": "another"},
    ],
)
def test_what_changes_what_the_others_do_is_told_at_once(
    telemetry: Telemetry, changes: dict[str, Any]
) -> None:
    assert _told(telemetry, range(1, 4), **changes)[0] == 2


def test_news_is_told_four_times_for_a_message_may_be_lost(telemetry: Telemetry) -> None:
    assert _told(telemetry, range(1, 12), order_id="another") == [2, 3, 4, 5, 10]


def test_a_goal_that_trembles_is_no_news(telemetry: Telemetry) -> None:
    x, y, z = telemetry.goal_position_enu_m
    assert _told(telemetry, range(1, 5), goal_position_enu_m=(x + 0.01, y, z)) == []


def test_an_agent_hears_whom_it_follows_often_and_only_the_others_slowly() -> None:
    followed: list[tuple[Topic, set[str]]] = []

    class Bus:
        node = "mav1"

        def follow(self, topic: Topic, names: Iterable[str], _: Callable[..., None]) -> None:
            followed.append((topic, set(names)))

    fleet = square_fleet(4)
    bus = cast(Any, Bus())
    inbox = Inbox(fleet.vehicles["mav1"], 1, bus, fleet.mocap)
    executor = CommandExecutor(
        name="mav1",
        others=["mav0", "mav2", "mav3"],
        link=cast(Any, None),
        bus=bus,
        inbox=inbox,
        on_exit=lambda: None,
        on_dropped=lambda: None,
    )
    executor.execute([agent_commands.Follow(frozenset({"mav0", "mav2"}))])
    executor.stop()
    # under its own name it would hear another agent for the same vehicle
    assert followed == [(Topic.STATE, {"mav0", "mav2"}), (Topic.FAR, {"mav1", "mav3"})]
