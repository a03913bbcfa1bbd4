"""A crowd that only talks: telemetry of many vehicles at 10 Hz on the real bus, and orders
answered, for benchmarks.

Nothing flies; the numbers move as if. It writes when each order came in, on the machine's monotonic
clock, so that who pressed a key can tell how long it took. Run by ``make bench-console`` as a
process of its own.
"""

from __future__ import annotations

import functools
import json
import math
import sys
import threading
import time
from collections.abc import Callable

import msgspec

from onboard.bus.codec import Malformed
from onboard.bus.control_token import ControlTokens
from onboard.bus.schema import Event, Order, OrderReply, Telemetry
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, load_fleet

RATE_HZ = 10.0
MAX_SESSIONS = 10  # as many nodes on the bus; larger fleets share them


def telemetry(
    name: str, place: int, start: tuple[float, float, float], time_s: float, sequence: int
) -> Telemetry:
    """A vehicle on a small circle about its start, 1 m up, held back by the law now and then."""
    angle = 0.6 * time_s + place
    x = start[0] + 0.4 * math.cos(angle)
    y = start[1] + 0.4 * math.sin(angle)
    spot = (x, y, 1.0 + 0.1 * math.sin(angle))
    speed = (-0.24 * math.sin(angle), 0.24 * math.cos(angle), 0.0)
    held = max(0.0, math.sin(0.2 * time_s + place))
    return Telemetry(
        vehicle=name,
        boot_id=1,
        sequence=sequence,
        stamp_ns=int(time_s * 1e9),
        state="flying",
        reason="",
        not_ready=(),
        is_armed=True,
        is_airborne=True,
        mode="OFFBOARD",
        position_enu_m=spot,
        velocity_enu_m_s=speed,
        yaw_deg=math.degrees(angle) % 360.0,
        is_position_valid=True,
        setpoint_position_enu_m=spot,
        goal_position_enu_m=(start[0], start[1], 1.0),
        battery_frac=max(0.3, 0.9 - time_s / 6000.0),
        battery_voltage_v=15.6,
        law="covey",
        law_status="saturated" if held > 0.5 else "inactive",
        intervention_m_s2=2.0 * held if held > 0.5 else 0.0,
        nearest_vehicle="",
        nearest_distance_m=math.nan,
        order_id="1",
        order_kind="move",
        order_phase="on the way",
        state_age_s=0.01,
        autopilot_age_s=0.02,
        neighbour_age_s=0.02,
        loop_period_p50_ms=20.0,
        loop_period_p99_ms=20.5 + held,
        loop_period_max_ms=23.0,
        late_ticks=0,
        malformed_messages=0,
        hover_thrust_frac=0.49,
        config_hash="bench",
        system_id=place % 250 + 1,
    )


class Crowd:
    """All vehicles of a fleet file, as nodes of the bus that publish and answer."""

    def __init__(self, fleet: FleetConfig, say: Callable[[dict[str, object]], None]) -> None:
        self.fleet = fleet
        self._say = say
        self._roles = ControlTokens()
        self._lock = threading.Lock()
        self._sequence = 0
        self._nodes: list[tuple[BusSession, list[str]]] = []
        names = list(fleet.enabled_names)
        count = min(MAX_SESSIONS, len(names))
        for index in range(count):
            mine = names[index::count]
            node = BusSession(
                namespace=fleet.namespace,
                node=mine[0],
                listen=[fleet.vehicles[name].agent for name in mine],
            )
            self._nodes.append((node, mine))

    def start(self) -> None:
        """Open the bus and answer orders."""
        for place, (node, names) in enumerate(self._nodes):
            node.start()
            if place == 0:
                node.watch_alive(self._see)
            for name in names:
                node.serve_orders(name, functools.partial(self._take, name))

    def publish(self, time_s: float) -> None:
        """Telemetry of everybody."""
        self._sequence += 1
        with self._lock:
            operator = self._roles.operator
            others = self._roles.others
        places = {name: place for place, name in enumerate(self.fleet.enabled_names)}
        for node, names in self._nodes:
            for name in names:
                told = telemetry(
                    name,
                    places[name],
                    self.fleet.vehicles[name].start_enu_m,
                    time_s,
                    self._sequence,
                )
                node.publish(
                    Topic.TELEMETRY,
                    name,
                    msgspec.structs.replace(told, operator=operator, roles=others),
                )

    def burst(self, count: int) -> None:
        """So many events, as fast as the bus takes them."""
        for number in range(count):
            node, names = self._nodes[number % len(self._nodes)]
            event = Event(
                vehicle=names[0],
                stamp_ns=number,
                severity="warning",
                code="bench",
                sentence=f"Burst, event {number}.",
            )
            node.publish(Topic.EVENT, names[0], event)

    def _see(self, node: str, is_alive: bool) -> None:
        with self._lock:
            self._roles.see(node, is_alive)

    def _take(
        self, name: str, order: Order | Malformed, reply: Callable[[OrderReply], None]
    ) -> None:
        now_s = time.monotonic()
        if isinstance(order, Order):
            self._say({"order": order.kind, "vehicle": name, "at_s": now_s})
            reply(OrderReply(order_id=order.order_id, vehicle=name, is_accepted=True, reason=""))


def main(argv: list[str]) -> int:
    """``python -m tests.bench.telemetry_source FLEET``: talks until its input ends; ``burst N``
    asks for events.
    """
    lock = threading.Lock()

    def say(told: dict[str, object]) -> None:
        with lock:
            print(json.dumps(told), flush=True)

    crowd = Crowd(load_fleet(argv[0]), say)
    crowd.start()
    ended = threading.Event()

    def listen() -> None:
        for line in sys.stdin:
            words = line.split()
            if words[:1] == ["burst"]:
                crowd.burst(int(words[1]))
                say({"burst": int(words[1]), "at_s": time.monotonic()})
        ended.set()

    threading.Thread(target=listen, daemon=True).start()
    say({"ready": True})
    begin_s = next_s = time.monotonic()
    while not ended.wait(max(0.0, next_s - time.monotonic())):
        crowd.publish(time.monotonic() - begin_s)
        next_s += 1.0 / RATE_HZ
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
