"""A vehicle that is disabled starts nothing, on the ground only, and is enabled again."""

from __future__ import annotations

import pytest

from onboard.bus.schema import Telemetry
from tests.onboard.agent.rig import Rig, hovering_rig, ready_rig


def told(rig: Rig) -> Telemetry:
    assert rig.telemetry is not None
    return rig.telemetry


def test_a_disabled_vehicle_refuses_to_start_and_says_who_has_disabled_it() -> None:
    rig = ready_rig()
    assert rig.order("disable", order_id="off").is_accepted
    rig.run(0.3)
    assert rig.outcomes()["off"] == "done"
    assert told(rig).disabled_by
    assert "is disabled by" in told(rig).not_ready[0]
    for kind in ("arm", "takeoff"):
        reply = rig.order(kind, order_id=kind)
        assert not reply.is_accepted
        assert "order enable mav0 to fly it" in reply.reason

    assert rig.order("enable", order_id="on").is_accepted
    rig.run(0.3)
    assert not told(rig).disabled_by
    assert not told(rig).not_ready
    assert rig.order("arm", order_id="again").is_accepted


@pytest.mark.parametrize("start", ["arm", "takeoff"])
def test_a_vehicle_that_is_armed_or_flies_is_not_disabled(start: str) -> None:
    rig = ready_rig() if start == "arm" else hovering_rig()
    if start == "arm":
        rig.order("arm", order_id="start")
        rig.run(3.0)
    reply = rig.order("disable", order_id="off")
    assert not reply.is_accepted
    assert "on the ground only, disarmed: it is" in reply.reason
    assert not told(rig).disabled_by
