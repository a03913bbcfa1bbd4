"""A vehicle whose goals follow another one is paused, goes on, and skips the rest of it."""

from __future__ import annotations

from typing import Any

from onboard.agent.core import AgentCore
from onboard.bus.control_token import ControlToken, ControlTokens
from onboard.bus.schema import Order
from onboard.flight.follow_flight import FollowFlight
from onboard.flight.state_machine import begin_failsafe
from onboard.flight.types import FlightView
from onboard.safety.failsafe_table import Action
from tests.onboard.agent.rig import Rig, fleet


def following() -> Rig:
    """A vehicle on its way to a goal that follows mav1."""
    rig = Rig(AgentCore(fleet(("mav0",)), "mav0", boot_id=7))
    rig.fly()
    assert goal(rig, 1.5).is_accepted
    rig.run(0.5)
    return rig


def goal(rig: Rig, x_m: float) -> Any:
    """Order the next goal of one that follows."""
    return rig.order("move", position_enu_m=(x_m, 0.0, 1.0), follows="mav1")


def test_a_pause_holds_and_refuses_goals_of_the_vehicle_that_is_followed_until_resume() -> None:
    rig = following()
    assert rig.telemetry is not None
    assert rig.telemetry.follows == "mav1"
    assert not rig.telemetry.is_path_paused

    paused = rig.order("pause", order_id="pause")
    assert paused.is_accepted
    rig.run(1.0)
    assert rig.core.flight.state == "holding"
    assert rig.telemetry.is_path_paused
    assert "lets it follow mav1 again" in str([event.sentence for event in rig.events])
    assert "resume" in goal(rig, 1.6).reason

    # `pause` is no order that takes the fleet from its mission
    assert rig.telemetry.taken_order_kind == "move"
    assert rig.order("resume").is_accepted
    assert goal(rig, 1.6).is_accepted
    rig.run(0.3)
    assert rig.core.flight.state == "flying"
    assert not rig.telemetry.is_path_paused


def test_who_skips_the_rest_holds_and_follows_again_only_after_another_order() -> None:
    rig = following()
    assert rig.order("skip").is_accepted
    rig.run(1.0)
    assert rig.core.flight.state == "holding"
    assert rig.telemetry is not None
    assert rig.telemetry.follows == ""
    assert "skip" in goal(rig, 1.6).reason

    assert rig.order("hold").is_accepted
    rig.run(0.3)
    assert goal(rig, 1.6).is_accepted


def test_another_order_ends_the_pause_and_a_vehicle_that_follows_nobody_is_not_paused() -> None:
    rig = following()
    assert rig.order("pause").is_accepted
    assert rig.order("move", position_enu_m=(0.5, 0.0, 1.0)).is_accepted
    rig.run(0.3)
    assert rig.telemetry is not None
    assert not rig.telemetry.is_path_paused
    assert "follows no path" in rig.order("pause").reason


def test_who_has_no_leader_or_has_skipped_the_rest_follows_nobody() -> None:
    assert FollowFlight(leader="mav1").is_under_way
    assert FollowFlight(leader="mav1", is_paused=True).is_under_way
    assert not FollowFlight(leader="mav1", is_skipped=True).is_under_way
    assert not FollowFlight().is_under_way


def of_another_ground(kind: str, author: str, **changes: Any) -> Order:
    return Order(
        order_id="o",
        author=author,
        kind=kind,  # type: ignore[arg-type]
        stamp_ns=0,
        deadline_ns=0,
        node="ground-2",
        **changes,
    )


def test_everybody_may_pause_and_only_who_operates_goes_on_from_a_second_ground() -> None:
    tokens = ControlTokens()
    tokens.see(str(ControlToken("operator", 1, "ground-1", "Ada L")), is_alive=True)

    assert tokens.refusal(of_another_ground("pause", "Bob")) is None
    for kind, changes in (
        ("resume", {}),
        ("skip", {}),
        ("move", {"position_enu_m": (0.0, 0.0, 1.0), "then_land": True}),
    ):
        assert tokens.refusal(of_another_ground(kind, "Ada L", **changes)) is None
        assert "operates this fleet" in str(tokens.refusal(of_another_ground(kind, "Bob")))
    assert tokens.refusal(of_another_ground("move", "Ada L")) is not None


def test_a_failsafe_that_holds_it_ends_the_following_until_another_order() -> None:
    rig = following()
    view = FlightView(rig.now_ns, (0.5, 0.0, 1.0), (0.0, 0.0, 0.0), True, rig.snapshot)
    begin_failsafe(rig.core.flight, view, Action.HOLD, "Loop stalled: holding.")
    rig.run(1.0)
    assert rig.core.flight.state == "holding"
    assert rig.telemetry is not None
    assert rig.telemetry.follows == ""
    answer = goal(rig, 1.6)
    assert not answer.is_accepted
    assert answer.reason == (
        "It follows mav1 no longer (Loop stalled: holding): order hold before it follows again."
    )

    assert rig.order("hold").is_accepted
    rig.run(0.3)
    assert goal(rig, 1.6).is_accepted
