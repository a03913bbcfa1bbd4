"""A person's order stays: a mission that has not heard of it does not replace it."""

from __future__ import annotations

import pytest

from onboard.bus.schema import BY_MISSION, OrderKind
from tests.onboard.agent.rig import Rig, hovering_rig

BOOT_ID = 7  # of the rig's agent


def _held(kind: OrderKind = "hold") -> Rig:
    rig = hovering_rig()
    rig.run(0.5)
    assert rig.order(kind, order_id="person").is_accepted
    return rig


@pytest.mark.parametrize("kind", ["land", "hold", "move"])
@pytest.mark.parametrize("persons", ["hold", "land"])
def test_a_mission_does_not_replace_an_order_that_it_has_not_heard_of(
    kind: OrderKind, persons: OrderKind
) -> None:
    rig = _held(persons)
    assert rig.telemetry is not None
    before_ns = rig.telemetry.stamp_ns
    fields = {"position_enu_m": (1.0, 0.0, 1.0)} if kind == "move" else {}
    reply = rig.order(kind, reason=BY_MISSION, heard_boot_id=BOOT_ID, heard_ns=before_ns, **fields)
    assert not reply.is_accepted
    assert reply.reason == (
        f"tester has ordered {persons}, which this mission had not heard of: that order stays."
    )


def test_a_mission_that_has_heard_of_it_may_order_and_a_kill_always() -> None:
    rig = _held()
    rig.run(0.2)
    assert rig.telemetry is not None
    assert rig.telemetry.taken_order_id == "person"
    assert rig.telemetry.taken_order_kind == "hold"
    assert rig.telemetry.taken_order_from == "tester ()"
    assert rig.order(
        "land", reason=BY_MISSION, heard_boot_id=BOOT_ID, heard_ns=rig.telemetry.stamp_ns
    ).is_accepted
    assert rig.order("kill", reason=BY_MISSION).is_accepted


def test_what_another_start_of_the_agent_has_told_is_not_heard() -> None:
    rig = _held()
    rig.run(0.2)
    reply = rig.order("land", reason=BY_MISSION, heard_boot_id=BOOT_ID - 1, heard_ns=2**62)
    assert not reply.is_accepted


def test_locate_is_no_order_that_stays() -> None:
    rig = hovering_rig()
    rig.order("locate")
    assert rig.order("land", reason=BY_MISSION).is_accepted
