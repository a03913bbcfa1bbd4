"""A client without a bus: three vehicles that circle, or whatever a test wants them to do."""

from __future__ import annotations

import math
import time
from collections import deque
from typing import Any

import msgspec

from groundstation.fleet import state as fleet_state
from groundstation.fleet.operator_control import Control
from groundstation.orders import grammar, plan
from groundstation.orders.held_formation import HeldFormation
from groundstation.orders.intents import Intent
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.result import OrderResult
from onboard.bus.control_token import ControlTokens
from onboard.bus.schema import Event, Telemetry, TickSample
from onboard.config.fleet import FleetConfig


def telemetry(vehicle: str = "mav0", **changes: object) -> Telemetry:
    zero = (0.0, 0.0, 0.0)
    usual = Telemetry(
        vehicle=vehicle,
        boot_id=1,
        sequence=1,
        stamp_ns=1,
        state="flying",
        reason="",
        not_ready=(),
        is_armed=True,
        is_airborne=True,
        mode="OFFBOARD",
        position_enu_m=(0.0, 0.0, 1.0),
        velocity_enu_m_s=(0.1, 0.0, 0.0),
        yaw_deg=0.0,
        is_position_valid=True,
        setpoint_position_enu_m=zero,
        goal_position_enu_m=(0.0, 1.0, 1.0),
        battery_frac=0.83,
        battery_voltage_v=11.6,
        law="covey",
        law_status="inactive",
        intervention_m_s2=0.0,
        nearest_vehicle="mav1",
        nearest_distance_m=1.4,
        order_id="",
        order_kind="",
        order_phase="",
        state_age_s=0.01,
        autopilot_age_s=0.02,
        neighbour_age_s=0.02,
        loop_period_p50_ms=20.0,
        loop_period_p99_ms=21.0,
        loop_period_max_ms=23.0,
        late_ticks=0,
        malformed_messages=0,
        hover_thrust_frac=0.75,
        config_hash="x",
        system_id=1,
    )
    return msgspec.structs.replace(usual, **changes)


class FakeTokens:
    """Control tokens on a bus without a bus: what is claimed, every vehicle sees at once."""

    def __init__(self) -> None:
        self.node = "ground-1"
        self.roles = ControlTokens()

    def claim(self, token: str) -> None:
        self.roles.see(token, True)

    def release(self, token: str) -> None:
        self.roles.see(token, False)


class FakeTicks:
    """Says whom the console follows; a test puts the values in."""

    def __init__(self) -> None:
        self.values: deque[TickSample] = deque(maxlen=1500)
        self.followed: str | None = None

    def follow(self, vehicle: str | None) -> None:
        self.followed = vehicle


class FakeClient:
    """Keeps what was ordered; telemetry comes from :meth:`hear`, other grounds' tokens into
    ``tokens.roles``.
    """

    def __init__(self, fleet: FleetConfig) -> None:
        self.fleet = fleet
        self.state = fleet_state.initial(fleet)
        self.handles: list[OrderResult] = []
        self.skew_ns = 0
        self._sequence = 1
        self.tick_stream = FakeTicks()
        self.tokens = FakeTokens()
        self.control = Control(
            self.tokens,
            "test",
            takes_control=True,
            say=lambda severity, sentence: self.say(sentence, severity, "ground"),
            clock_ns=self.now_ns,
        )

    def now_ns(self) -> int:
        return time.monotonic_ns() + self.skew_ns

    def hear(self, vehicle: str, **changes: object) -> None:
        self._sequence += 1
        roles = self.tokens.roles
        usual = {"operator": roles.operator, "roles": roles.others}
        usual["config_hash"] = self.fleet.config_hash
        heard = telemetry(vehicle, sequence=self._sequence, **{**usual, **changes})
        self.state = fleet_state.fold(self.state, heard, self.now_ns())

    def say(
        self,
        sentence: str,
        severity: Any = "info",
        vehicle: str = "mav0",
        outcome: Any = "",
        code: str = "x",
    ) -> None:
        event = Event(
            vehicle=vehicle,
            stamp_ns=1,
            severity=severity,
            code=code,
            sentence=sentence,
            order_id="1" if outcome else "",
            order_outcome=outcome,
        )
        self.state = fleet_state.fold(self.state, event, self.now_ns())

    def forget_silent(self, name: str) -> bool:
        before = self.state
        self.state = fleet_state.without_silent(before, name, self.now_ns())
        return self.state.unlisted != before.unlisted

    def plan(self, order: Intent | str) -> PlannedOrder:
        intent = grammar.parse(order, self.fleet) if isinstance(order, str) else order
        held = HeldFormation(grammar.default_formation(self.fleet))
        return plan.plan_order(
            intent, self.fleet, self.state, held=held, author="test", now_ns=self.now_ns()
        )

    def check_again(self, planned: PlannedOrder) -> PlannedOrder:
        return plan.check_again(planned, self.fleet, self.state, self.now_ns())

    def is_of_mission(self, order_id: str) -> bool:
        return False

    def is_own(self, order_id: str) -> bool:
        return order_id.startswith("ground-1-")

    def newest_order(self, vehicle: str) -> OrderResult | None:
        given = [handle for handle in self.handles if vehicle in handle.planned.orders]
        return given[-1] if given else None

    def send(self, planned: PlannedOrder) -> OrderResult:
        self.handles.append(OrderResult(planned))
        return self.handles[-1]

    async def submit(self, order: Intent | str) -> OrderResult:
        return self.submit_now(order)

    def submit_now(self, order: Intent | str) -> OrderResult:
        return self.send(self.plan(order))

    @property
    def ordered(self) -> list[str]:
        return [str(handle.intent) for handle in self.handles]

    def circle(self, time_s: float) -> None:
        """A scene: three vehicles turn about a moving middle, now and then close."""
        radius = 1.0 + 0.45 * math.sin(0.35 * time_s)
        names = self.fleet.enabled_names
        for index, name in enumerate(names):
            angle = 0.25 * time_s + 2.0 * math.pi * index / len(names)
            position = (radius * math.cos(angle), 0.6 + radius * math.sin(angle), 1.0 + 0.1 * index)
            gap_m = radius * 2.0 * math.sin(math.pi / len(names))
            self.hear(
                name,
                position_enu_m=position,
                goal_position_enu_m=((0.0, 2.1, 1.0), (-0.8, 0.7, 1.0), (0.8, 0.7, 1.0))[index % 3],
                velocity_enu_m_s=(
                    -0.25 * radius * math.sin(angle),
                    0.25 * radius * math.cos(angle),
                    0.0,
                ),
                nearest_vehicle=names[(index + 1) % len(names)],
                nearest_distance_m=gap_m,
                order_kind="move",
                order_phase="under way",
                law_status="saturated" if gap_m < 1.3 else "inactive",
                avoids=names[(index + 1) % len(names)] if gap_m < 1.3 else "",
                state="flying",
                intervention_m_s2=max(0.0, 1.6 - gap_m) * 3,
                battery_frac=0.9 - 0.3 * index,
                system_id=index + 1,
            )
