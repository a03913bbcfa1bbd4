"""A vehicle that the fleet file disables and that is heard all the same: shown, counted, and to be
brought down.
"""

from __future__ import annotations

import msgspec
import pytest

from groundstation.alarms.alarm_table import GroundCondition
from groundstation.alarms.alarms import conditions
from groundstation.fleet import state as fleet_state
from groundstation.orders.held_formation import HeldFormation
from groundstation.orders.intents import INTENTS
from groundstation.orders.plan import plan_order
from onboard.config.fleet import FleetConfig, load_fleet
from tests.groundstation.console.fake import telemetry


def _fleet() -> FleetConfig:
    whole = load_fleet("configs/fleets/paper.toml")
    off = msgspec.structs.replace(whole.vehicles["mav2"], enabled=False)
    return msgspec.structs.replace(whole, vehicles={**whole.vehicles, "mav2": off})


def test_it_is_shown_counted_and_alarmed_as_soon_as_it_is_heard() -> None:
    fleet = _fleet()
    state = fleet_state.initial(fleet)
    assert list(state.vehicles) == ["mav0", "mav1"]
    state = fleet_state.fold(
        state, telemetry("mav0", sequence=1, position_enu_m=(0.0, 0.0, 1.0)), 5
    )
    flying = telemetry(
        "mav2", sequence=1, position_enu_m=(0.9, 0.0, 1.0), is_airborne=True, is_armed=True
    )
    state = fleet_state.fold(state, flying, 5)
    assert state.smallest is not None
    assert (state.smallest.first, state.smallest.second) == ("mav0", "mav2")
    assert state.smallest.distance_m == pytest.approx(0.9)
    assert [
        one.subject
        for one in conditions(state, fleet, 5)
        if one.kind is GroundCondition.DISABLED_FLIES
    ] == ["mav2"]
    unknown_vehicle = telemetry("nobody", sequence=1)
    assert fleet_state.fold(state, unknown_vehicle, 6) is state


def test_it_may_be_brought_down_and_not_flown() -> None:
    fleet = _fleet()
    for verb, is_sent in (
        ("land", True),
        ("kill", True),
        ("hold", True),
        ("takeoff", False),
        ("arm", False),
    ):
        intent = INTENTS[verb](vehicles=("mav2",))
        planned = plan_order(intent, fleet, None, held=HeldFormation(None), author="me", now_ns=1)
        assert ("mav2" in planned.orders) is is_sent, verb
        assert ("mav2" in planned.refusals) is not is_sent, verb
