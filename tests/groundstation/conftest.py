"""A paper fleet, and a bus with agents that do what they are told, in a few milliseconds and
without sockets.
"""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from onboard.bus.control_token import ControlTokens
from onboard.bus.protocol import Bus
from onboard.bus.schema import Event, Order, OrderOutcome, OrderReply, Telemetry, Truth
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, load_fleet

ROOT = Path(__file__).resolve().parents[2]
ZERO = (0.0, 0.0, 0.0)


def telemetry(vehicle: str = "mav0", **changes: Any) -> Telemetry:
    """A healthy vehicle on the ground."""
    base = Telemetry(
        vehicle=vehicle,
        boot_id=1,
        sequence=1,
        stamp_ns=0,
        state="ready",
        reason="",
        not_ready=(),
        is_armed=False,
        is_airborne=False,
        mode="HOLD",
        position_enu_m=ZERO,
        velocity_enu_m_s=ZERO,
        yaw_deg=0.0,
        is_position_valid=True,
        setpoint_position_enu_m=ZERO,
        goal_position_enu_m=ZERO,
        battery_frac=0.9,
        battery_voltage_v=12.0,
        law="covey",
        law_status="inactive",
        intervention_m_s2=0.0,
        nearest_vehicle="",
        nearest_distance_m=0.0,
        order_id="",
        order_kind="",
        order_phase="",
        state_age_s=0.0,
        autopilot_age_s=0.0,
        neighbour_age_s=0.0,
        loop_period_p50_ms=20.0,
        loop_period_p99_ms=20.5,
        loop_period_max_ms=21.0,
        late_ticks=0,
        malformed_messages=0,
        hover_thrust_frac=0.5,
        config_hash="",
        system_id=1,
    )
    return msgspec.structs.replace(base, **changes)


class FakeBus:
    """Agents that accept every order and fulfil it at once; ``misbehave`` changes that per vehicle.

    misbehave: vehicle -> "silent" (no answer), "refuse", "fail" (accepts, then fails), "stuck"
    (accepts, never ends), "late" (fulfils it after the others).
    """

    is_simulated = True

    def __init__(self, fleet: FleetConfig, *, has_truth: bool = False) -> None:
        self.fleet = fleet
        self.has_truth = has_truth
        self.misbehave: dict[str, str] = {}
        self.collided: set[str] = set()  # vehicles that have touched another one, for ever

        self.accept_only: set[str] = set()  # kinds of orders that are accepted and do not end
        self.orders: list[tuple[str, Order]] = []
        self.vehicles = {
            name: telemetry(
                name,
                position_enu_m=fleet.vehicles[name].start_enu_m,
                config_hash=fleet.config_hash,
            )
            for name in fleet.enabled_names
        }

        self.truth_error_m = 0.0
        self.node = "ground-test"
        self.is_simulated = True
        self.roles = ControlTokens()

        self.on_message: dict[Topic, Callable[..., None]] = {}
        self._sequence = itertools.count(2)
        self._task: asyncio.Task[None] | None = None
        self._loop = asyncio.get_running_loop()

    def start(self) -> None:
        self._task = None

    def stop(self) -> None:
        return

    def subscribe(self, topic: Topic, name: str, on_message: Callable[..., None]) -> None:
        self.on_message[topic] = on_message

    def collect(
        self, topic: Topic, name: str, on_message: Callable[..., None], *, most: int
    ) -> None:
        self.subscribe(topic, name, on_message)

    def deliver(self) -> None:
        return

    def claim(self, token: str) -> None:
        self.roles.see(token, True)

    def release(self, token: str) -> None:
        self.roles.see(token, False)

    def watch_alive(self, on_alive: Callable[[str, bool], None]) -> None:
        for name in self.vehicles:
            on_alive(name, True)

    async def beat(self) -> None:
        """Telemetry and truth of all, for ever."""
        while True:
            for name in self.vehicles:
                self.tell(name)
            await asyncio.sleep(0.02)

    def tell(self, name: str, **changes: Any) -> None:
        """One telemetry of a vehicle, with changes that last."""
        now_ns = time.monotonic_ns()
        message = msgspec.structs.replace(
            self.vehicles[name], **changes, stamp_ns=now_ns, sequence=next(self._sequence)
        )

        message = msgspec.structs.replace(
            message, operator=self.roles.operator, roles=self.roles.others
        )

        self.vehicles[name] = message
        self.on_message[Topic.TELEMETRY](Topic.TELEMETRY, name, message)

        if self.has_truth:
            x, y, z = message.position_enu_m
            truth = Truth(
                vehicle=name,
                stamp_ns=now_ns,
                position_enu_m=(x + self.truth_error_m, y, z),
                velocity_enu_m_s=ZERO,
                quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
                is_on_ground=not message.is_airborne,
                is_collided=name in self.collided,
            )
            self.on_message[Topic.TRUTH](Topic.TRUTH, name, truth)

    def order(
        self, vehicle: str, order: Order, *, timeout_s: float, on_reply: Any, on_end: Any
    ) -> None:
        self.orders.append((vehicle, order))

        how = self.misbehave.get(vehicle, "")
        if how == "silent":
            return

        reason = "Because I say so." if how == "refuse" else ""
        on_reply(
            OrderReply(
                order_id=order.order_id, vehicle=vehicle, is_accepted=not reason, reason=reason
            )
        )

        if how not in ("refuse", "stuck") and order.kind not in self.accept_only:
            after_s = 0.5 if how == "late" else 0.03
            self._loop.call_later(after_s, self._end, vehicle, order, how)

    def _end(self, name: str, order: Order, how: str) -> None:
        x, y, _ = self.vehicles[name].position_enu_m
        if how != "fail":
            if order.kind == "takeoff":
                spot = (x, y, order.height_m)
                self.tell(
                    name,
                    state="flying",
                    is_airborne=True,
                    is_armed=True,
                    position_enu_m=spot,
                    goal_position_enu_m=spot,
                )
            elif order.kind == "move":
                self.tell(
                    name,
                    position_enu_m=order.position_enu_m,
                    goal_position_enu_m=order.position_enu_m,
                    follows=order.follows,
                )
            elif order.kind in ("pause", "resume") and self.vehicles[name].follows:
                self.tell(name, is_path_paused=order.kind == "pause")
            elif order.kind == "skip":
                self.tell(name, state="holding", reason="ordered", follows="")
            elif order.kind in ("land", "kill"):
                self.tell(
                    name,
                    state="landed",
                    is_airborne=False,
                    is_armed=False,
                    position_enu_m=(x, y, 0.0),
                )

        if how == "fail":
            self.report_end(name, order, "failed", "The motor is weak.")
        else:
            self.report_end(name, order, "done", "Done.")

    def report_end(self, name: str, order: Order, outcome: OrderOutcome, sentence: str) -> None:
        """Let a vehicle report how an order has ended."""
        event = Event(
            vehicle=name,
            stamp_ns=time.monotonic_ns(),
            severity="info",
            code="order",
            sentence=sentence,
            order_id=order.order_id,
            order_outcome=outcome,
        )
        self.on_message[Topic.EVENT](Topic.EVENT, name, event)


@pytest.fixture
def fleet() -> FleetConfig:
    return load_fleet(ROOT / "configs/fleets/paper.toml")


@pytest.fixture
def make_telemetry() -> Callable[..., Telemetry]:
    return telemetry


@pytest.fixture
async def bus(fleet: FleetConfig) -> Any:
    """A fake bus whose vehicles report."""
    return FakeBus(fleet, has_truth=True)


@pytest.fixture
async def client(fleet: FleetConfig, bus: FakeBus) -> Any:
    """A started client on the fake bus."""
    from groundstation.client.client import FleetClient

    found = FleetClient(fleet, author="tester", bus=cast(Bus, bus))
    await found.start()
    beat = asyncio.create_task(bus.beat())
    yield found
    beat.cancel()
    await found.stop()
