"""PX4 starts anew by an order, on the ground and disarmed; done when its clock has begun anew."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import structs

from onboard import agent_commands
from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import Order
from onboard.flight import order_checks, state_machine
from onboard.flight.context import FlightContext
from onboard.flight.order_checks import OrderFacts
from onboard.flight.types import FlightStep, FlightView
from tests.onboard.agent.rig import fleet
from tests.onboard.flight.open_space import OPEN_SPACE

_S = 1_000_000_000
_NOW_NS = 1000 * _S


class Ground:
    """A vehicle on the ground, whose PX4 says what a test sets."""

    def __init__(self, step: FlightStep = FlightStep.READY) -> None:
        config = fleet()
        self.flight = FlightContext(config, config.vehicles["mav0"], step=step)
        self.now_ns = _NOW_NS
        self.snapshot = Snapshot(
            heartbeat_ns=self.now_ns,
            mode="HOLD",
            landed=Landed.ON_GROUND,
            landed_ns=self.now_ns,
            px4_boot_ms=600_000,
            attitude_ns=self.now_ns,
        )

    def view(self) -> FlightView:
        return FlightView(
            now_ns=self.now_ns,
            position_enu_m=(0.0, 0.0, 0.0),
            velocity_enu_m_s=(0.0, 0.0, 0.0),
            has_position=True,
            snapshot=self.snapshot,
        )

    def refusal(self) -> str | None:
        return order_checks.refusal(self._order(), self.flight, self._facts())

    def order(self) -> None:
        assert self.refusal() is None
        state_machine.begin_order(self.flight, self.view(), self._order())

    def pass_time(self, seconds: float, **px4: Any) -> None:
        """Let time pass; PX4 says this from then on, or is silent."""
        self.now_ns += round(seconds * 1e9)
        if px4:
            self.snapshot = structs.replace(
                self.snapshot,
                heartbeat_ns=self.now_ns,
                landed_ns=self.now_ns,
                attitude_ns=self.now_ns,
                **px4,
            )
        state_machine.advance(self.flight, self.view())

    @property
    def outcomes(self) -> list[tuple[str, str]]:
        events = [
            command.message
            for command in self.flight.commands
            if isinstance(command, agent_commands.Publish)
        ]
        return [
            (event.order_outcome, event.sentence)  # type: ignore[attr-defined]
            for event in events
            if getattr(event, "order_outcome", "")
        ]

    def _order(self) -> Order:
        return Order(order_id="r", author="x", kind="reboot", stamp_ns=0, deadline_ns=0)

    def _facts(self) -> OrderFacts:
        return OrderFacts(
            view=self.view(),
            fleet=self.flight.fleet,
            surroundings=OPEN_SPACE,
            others={},
            last_positions_enu_m={},
            distances_m={},
            not_ready=(),
            not_ready_in_air=lambda: (),
        )


def test_it_is_done_when_px4_is_heard_again_with_a_clock_that_began_after_the_order() -> None:
    ground = Ground()
    ground.order()
    sent = [type(command) for command in ground.flight.commands]
    assert sent.count(agent_commands.RebootPx4) == 1
    assert ground.flight.state == "waiting"

    ground.pass_time(0.5, px4_boot_ms=600_500)  # it has yet to go down
    ground.pass_time(4.0)  # silent
    assert not ground.outcomes
    ground.pass_time(1.0, px4_boot_ms=300)
    assert ground.outcomes == [("done", "PX4 has started anew. Its preflight takes some seconds.")]
    assert ground.flight.step is FlightStep.WAITING
    sent = [type(command) for command in ground.flight.commands]
    assert sent.count(agent_commands.RebootPx4) == 1


def test_a_px4_that_goes_on_or_stays_away_is_named_as_such() -> None:
    for px4, words in (({"px4_boot_ms": 700_000}, "has not begun anew"), ({}, "heard again")):
        ground = Ground()
        ground.order()
        ground.pass_time(31.0, **px4)
        ((outcome, sentence),) = ground.outcomes
        assert outcome == "timed out"
        assert words in sentence
        assert ground.flight.step is FlightStep.WAITING


def test_a_px4_that_had_run_for_seconds_only_and_stays_away_has_not_started_anew() -> None:
    ground = Ground()
    ground.snapshot = structs.replace(ground.snapshot, px4_boot_ms=5_000)
    ground.order()
    ground.pass_time(0.2, px4_boot_ms=5_200)  # it has yet to go down
    ground.pass_time(6.0)  # silent for longer than it had run
    assert not ground.outcomes
    ground.pass_time(24.0)
    assert [outcome for outcome, _ in ground.outcomes] == ["timed out"]


def test_a_pilot_who_arms_meanwhile_ends_it() -> None:
    ground = Ground()
    ground.order()
    ground.pass_time(0.5, px4_boot_ms=600_500, is_armed=True)
    assert ground.outcomes[0][0] == "failed"


@pytest.mark.parametrize(
    ("px4", "step", "words"),
    [
        ({"is_armed": True}, FlightStep.READY, "order disarm first"),
        ({"landed": Landed.IN_AIR}, FlightStep.READY, "does not say that the vehicle is on"),
        ({"landed_ns": 0}, FlightStep.READY, "take its power off"),
        ({}, FlightStep.HOLDING, "on the ground only, disarmed: it is holding"),
        ({}, FlightStep.ARMED, "on the ground only, disarmed: it is armed"),
        ({}, FlightStep.REBOOTING, "it is waiting (PX4 reboots)"),
    ],
)
def test_in_the_air_or_armed_it_is_refused_in_words(
    px4: dict[str, Any], step: FlightStep, words: str
) -> None:
    ground = Ground(step)
    ground.snapshot = structs.replace(ground.snapshot, **px4)
    refusal = ground.refusal()
    assert refusal is not None
    assert words in refusal


def test_nobody_takes_off_while_px4_reboots() -> None:
    ground = Ground()
    ground.order()
    assert not state_machine.accepts(ground.flight.step, "takeoff")
    state_machine.preflight_checked(ground.flight, ground.view(), is_ready=True)
    assert ground.flight.step is FlightStep.REBOOTING
