"""What a flight tells people about its ends: who, where, and PX4's own words while they are new."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from onboard.autopilot import Snapshot
from onboard.bus.codec import decode, encode
from onboard.bus.schema import Order
from onboard.flight import sentences
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightView
from tests.onboard.agent.rig import fleet

_FLEET = fleet()
_BEGIN_NS = 50_000_000_000
_KILL = Order(order_id="o", author="Ada", kind="kill", stamp_ns=0, deadline_ns=0)


def _flight(**changes: Any) -> FlightContext:
    vehicle = _FLEET.vehicles["mav0"]
    return FlightContext(**{"fleet": _FLEET, "vehicle": vehicle, "step_ns": _BEGIN_NS, **changes})


def _view(**px4: Any) -> FlightView:
    return FlightView(
        now_ns=_BEGIN_NS + 10**9,
        position_enu_m=(0.1, 0.2, 1.5),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        has_position=True,
        snapshot=Snapshot(**px4),
    )


def test_a_kill_names_its_author_and_his_ground() -> None:
    named = _flight(order=replace(_KILL, node="ground-1"))
    assert sentences.killed(named, _view()) == "Killed by order of Ada."
    assert "by order of Ada (from ground-1)." in sentences.killed_in_the_air(named, _view())
    nameless = _flight(order=_KILL)
    assert "Ada (from an unnamed ground)." in sentences.killed_in_the_air(nameless, _view())
    assert sentences.killed_in_the_air(_flight(), _view()) == ""


def test_a_long_name_is_cut_off() -> None:
    disabled = sentences.disabled(_flight(disabled_by="A" * 80))
    assert "by " + "A" * 60 + ":" in disabled

    kill = replace(_KILL, author="A" * 30_000, node="g" * 30_000)
    assert isinstance(decode(encode(kill), Order), Order)  # such an order reaches an agent
    assert sentences.killed(_flight(order=kill), _view()) == f"Killed by order of {'A' * 60}."
    in_the_air = sentences.killed_in_the_air(_flight(order=kill), _view())
    assert in_the_air.endswith(f"by order of {'A' * 60} (from {'g' * 60}).")


@pytest.mark.parametrize(("said_ns", "is_told"), [(_BEGIN_NS, False), (_BEGIN_NS + 1, True)])
def test_px4_is_quoted_with_what_it_has_said_since_the_step_began(
    said_ns: int, is_told: bool
) -> None:
    view = _view(status_text="Arming denied", status_text_ns=said_ns)
    assert ("Arming denied" in sentences.not_armed(_flight(), view)) is is_told
    assert ("Arming denied" in sentences.not_rebooted(_flight(), view)) is is_told
    assert ("Arming denied" in sentences.still_armed(_flight(), view)) is is_told


@pytest.mark.parametrize(
    ("heard_ns", "words"),
    [(_BEGIN_NS, "has not been heard again"), (_BEGIN_NS + 1, "clock has not begun anew")],
)
def test_a_px4_that_does_not_start_anew_is_silent_or_goes_on(heard_ns: int, words: str) -> None:
    assert words in sentences.not_rebooted(_flight(), _view(heartbeat_ns=heard_ns))


def test_the_end_of_a_flight_says_where_and_why() -> None:
    assert sentences.at_height(_flight(), _view()) == "At 1.50 m."
    assert sentences.why_landed(_flight(reason="Too windy."), _view()) == "Too windy."
    assert sentences.why_landed(_flight(), _view()) == "Landed."

    disarmed = _flight(reason=sentences.LANDS_TO_DISARM)
    assert "landed at once. Landed and disarmed." in sentences.landed_as_ordered(disarmed, _view())
    assert sentences.landed_as_ordered(_flight(), _view()) == "Landed and disarmed."

    assert "its mode is RTL:" in sentences.px4_does_not_land(_flight(), _view(mode="RTL"))
    assert "its mode is unknown:" in sentences.px4_does_not_land(_flight(), _view())
