"""How something is broken in a flight in lockstep: functions that are called in flight with a
vehicle's name.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from groundstation.orders.grammar import OrderError
from onboard import agent_inputs
from onboard.autopilot import Landed
from onboard.bus.schema import Message, MocapPose, StateMessage, Telemetry
from onboard.bus.topics import Topic
from onboard.config.areas import Area, Point
from onboard.config.flight_space import flight_space_of
from onboard.config.wind_limit import wind_limit_m_s
from onboard.control.pipeline import pipeline_params
from sitl.faults.catalogue import Fault
from sitl.lockstep.connections import BusSettings
from sitl.lockstep.flight import GROUND, Lockstep
from sitl.lockstep.simulation import TICK_STEPS
from sitl.physics.vehicle import STEP_S
from sitl.px4.modes import Mode

_BEYOND_M = 5.0  # of the fence
_LEAST_HEIGHT_M = 0.5
_WIND_RISES_IN_S = 20.0
_STRONGEST_WIND_M_S = 30.0  # of the emulator's air
_SLOW_DELAY_S = 0.4
_STARVED_FOR_S = 6.0
# besides the time for which vehicles wait for a ground
_HANGS_LONGER_S = 8.0
_DEAD_LONGER_S = 16.0  # by then everybody has landed

Inject = Callable[[Lockstep, str], None]


def fault(kind: str, duration_s: float = 0.0, **parameters: float | str) -> Inject:
    """Return the injection of a fault of the emulator, as ``covey sitl --fault`` plans it."""

    def inject(flight: Lockstep, name: str) -> None:
        flight.inject(
            Fault(kind, name, at_s=flight.time_s, duration_s=duration_s, parameters=parameters)
        )

    return inject


def of_all(inject_one: Inject) -> Inject:
    """Return what breaks the same thing for all vehicles at once, as where they share it."""

    def inject(flight: Lockstep, _name: str) -> None:
        for name in flight.config.enabled_names:
            inject_one(flight, name)

    return inject


def swap(duration_s: float) -> Inject:
    """The motion capture takes the vehicle and the next one for each other."""

    def inject(flight: Lockstep, name: str) -> None:
        names = flight.config.enabled_names
        other = names[(names.index(name) + 1) % len(names)]
        fault("mocap_swapped", duration_s, other=other)(flight, name)

    return inject


def kill(flight: Lockstep, name: str) -> None:
    """SIGKILL to the agent."""
    flight.agents[name].kill()


def kill_and_start(flight: Lockstep, name: str) -> None:
    """SIGKILL to the agent, and a new one a second later."""
    flight.agents[name].kill()
    flight.at(flight.time_s + 1.0, flight.agents[name].start)


def hang(duration_s: float) -> Inject:
    """The agent stands still for a time."""

    def inject(flight: Lockstep, name: str) -> None:
        flight.agents[name].hang()
        if math.isfinite(duration_s):
            flight.at(flight.time_s + duration_s, flight.agents[name].resume)

    return inject


def stop_agent(flight: Lockstep, name: str) -> None:
    """SIGTERM to the agent."""
    flight.agents[name].request_stop()


def cut(duration_s: float, *, keeps: tuple[str, ...] = (), all_agents: bool = False) -> Inject:
    """Cut the vehicle, or every agent, from all nodes but those it keeps."""

    def inject(flight: Lockstep, name: str) -> None:
        names = flight.config.enabled_names if all_agents else (name,)
        for one in names:
            for other in [*flight.config.enabled_names, GROUND, "sitl"]:
                if other != one and other not in keeps:
                    flight.bus.cut(one, other)
        flight.at(flight.time_s + duration_s, flight.bus.heal)

    return inject


def cut_ground(duration_s: float) -> Inject:
    """Nothing passes between the ground and everybody else for a time."""

    def inject(flight: Lockstep, _name: str) -> None:
        flight.bus.partition([GROUND])
        if math.isfinite(duration_s):
            flight.at(flight.time_s + duration_s, flight.bus.heal)

    return inject


def slow_ground(flight: Lockstep, _name: str) -> None:
    """Every message of the ground takes its time, for the rest of the flight."""
    for name in flight.config.enabled_names:
        flight.bus.set_link(GROUND, name, BusSettings(delay_s=_SLOW_DELAY_S))


def starve_ground(flight: Lockstep, _name: str) -> None:
    """Its computer is too busy: the event loop runs seldom, and not for long."""
    rng = np.random.default_rng([round(flight.time_s / STEP_S), 20])
    begin_s = flight.time_s
    while begin_s < flight.time_s + _STARVED_FOR_S:
        gap_s = float(rng.uniform(0.1, 0.9))
        flight.at(begin_s, functools.partial(flight.hold_ground, gap_s))
        begin_s += gap_s + 0.02


def hang_ground(duration_s: float) -> Inject:
    """SIGSTOP, and SIGCONT some time later."""

    def inject(flight: Lockstep, _name: str) -> None:
        flight.hold_ground(duration_s, is_stopped=True)

    return inject


def hang_ground_for_long(flight: Lockstep, _name: str) -> None:
    """SIGSTOP, and SIGCONT only after vehicles have begun to land because of it."""
    longest_s = flight.config.fleet.ground_lost_land_s + _HANGS_LONGER_S
    flight.hold_ground(longest_s, is_stopped=True)


def kill_ground(flight: Lockstep, _name: str) -> None:
    """The process ends: its connections close, and it does nothing any more."""
    flight.bus.nodes[GROUND].stop()
    flight.hold_ground(flight.config.fleet.ground_lost_land_s + _DEAD_LONGER_S)


def bad_bus(flight: Lockstep, name: str) -> None:
    """Messages between the vehicle and the others are lost, late, doubled and overtaken."""
    bad = BusSettings(delay_s=0.01, jitter_s=0.02, loss=0.3, reorder=0.2, duplicate=0.2)
    for other in flight.config.enabled_names:
        if other != name:
            flight.bus.set_link(name, other, bad)


def pilot(mode: Mode) -> Inject:
    """Somebody at the transmitter, or another ground station, takes the vehicle."""

    def inject(flight: Lockstep, name: str) -> None:
        emulator = flight.simulation.emulator
        px4 = emulator.autopilots[flight.simulation.names.index(name)]
        px4.request(emulator.time_s, mode)

    return inject


def tick_fails(count: int) -> Inject:
    """An error of our own: ticks without a result."""

    def inject(flight: Lockstep, name: str) -> None:
        def fail() -> None:
            core = flight.agents[name].core
            core.handle(
                agent_inputs.TickFailed("Internal error: ZeroDivisionError: injected."),
                flight.simulation.now_ns,
            )

        for number in range(count):
            flight.at(flight.time_s + 0.02 * number, fail)

    return inject


_FAR_AHEAD = 2**60


def nonsense(flight: Lockstep, name: str) -> None:
    """Send bad states and poses in the name of others: not finite, huge, repeated, numbered far
    ahead, of nobody.
    """
    other = next(one for one in flight.config.enabled_names if one != name)
    liar = flight.bus.node("liar")
    liar.start()
    heard: list[StateMessage] = []

    def listen(_topic: Topic, _name: str, message: object) -> None:
        if isinstance(message, StateMessage) and message.sequence > 0:
            heard[:] = [message]

    def number_ahead(_topic: Topic, _name: str, message: object) -> None:
        if isinstance(message, MocapPose) and message.sequence < _FAR_AHEAD:
            lie = msgspec.structs.replace(
                message, sequence=_FAR_AHEAD, stamp_ns=message.stamp_ns + 1
            )
            liar.publish(Topic.MOCAP, message.body, lie)

    liar.subscribe(Topic.STATE, other, listen)
    for vehicle in flight.config.enabled_names:
        liar.subscribe(Topic.MOCAP, flight.config.vehicles[vehicle].body or vehicle, number_ahead)
    lies: tuple[dict[str, object], ...] = (
        {"position_enu_m": (math.nan, 0.0, 0.0)},
        {"velocity_enu_m_s": (math.inf, 0.0, 0.0)},
        {"sequence": -5, "position_enu_m": (1e300, 1e300, 1e300)},
        {"sequence": 0},
        {"sequence": _FAR_AHEAD},
        {"boot_id": _FAR_AHEAD, "sequence": _FAR_AHEAD},
        {"vehicle": "nobody", "position_enu_m": (0.0, 0.0, 1.0)},
        {"predicted_position_enu_m": (1e30, 0.0, 0.0)},
    )

    def lie(number: int) -> None:
        if heard:
            told = msgspec.structs.replace(heard[0], **lies[number % len(lies)])
            liar.publish(Topic.STATE, told.vehicle, told)

    for number in range(120):
        flight.at(flight.time_s + 0.01 * number, functools.partial(lie, number))
    flight.at(flight.time_s + 1.5, liar.stop)


def landed_state(duration_s: float, *, is_repeated: bool) -> Inject:
    """PX4 reports the ground wherever it is: for a while, or its last report stays."""

    def inject(flight: Lockstep, name: str) -> None:
        link = flight.agents[name].link
        end_s = flight.time_s + duration_s
        receive = link.receive

        def change(fields: dict[str, Any]) -> None:
            if "landed" in fields and flight.time_s < end_s:
                lie = {"landed": Landed.ON_GROUND} if is_repeated else {}
                fields = {key: value for key, value in fields.items() if key != "landed"} | lie
            receive(fields)

        link.receive = change  # type: ignore[method-assign]
        receive({"landed": Landed.ON_GROUND})

    return inject


# one datagram of somebody who plays a vehicle's PX4
WRONG_REPORTS: dict[str, dict[str, Any]] = {
    "disarmed": {"is_armed": False, "mode": "OFFBOARD"},
    "another mode": {"is_armed": True, "mode": "POSCTL"},
    "a failsafe": {"is_armed": True, "mode": "LAND", "is_failsafe": True},
    "a small clock": {"quaternion_enu_flu_wxyz": (1.0, 0.0, 0.0, 0.0), "px4_boot_ms": 20},
    "a large clock": {"quaternion_enu_flu_wxyz": (1.0, 0.0, 0.0, 0.0), "px4_boot_ms": 4_000_000},
    "upside down": {"quaternion_enu_flu_wxyz": (0.0, 1.0, 0.0, 0.0)},
    "a battery of 5 %": {"battery_frac": 0.05, "battery_voltage_v": 13.0},
    "on the ground": {"landed": Landed.ON_GROUND},
}


def wrong_report(name: str) -> Inject:
    """Return the injection of one wrong report; the next true one comes as always."""

    def inject(flight: Lockstep, vehicle: str) -> None:
        link = flight.agents[vehicle].link
        fields = dict(WRONG_REPORTS[name])
        if "quaternion_enu_flu_wxyz" in fields:
            fields.setdefault("px4_boot_ms", link.snapshot().px4_boot_ms + 10)
        # after the true report of this tick and before the tick: the newest of a kind is the one
        # that is read
        step_s = STEP_S
        steps = flight.simulation.emulator.world.vehicles.steps
        flight.at(
            step_s * (steps + TICK_STEPS - 1 - steps % TICK_STEPS), lambda: link.receive(fields)
        )

    return inject


def some_wrong_report(flight: Lockstep, vehicle: str) -> None:
    """One wrong report, another one at each tick."""
    wrong_report(list(WRONG_REPORTS)[round(flight.time_s / 0.02) % len(WRONG_REPORTS)])(
        flight, vehicle
    )


def repeated(inject: Inject, count: int, every_s: float) -> Inject:
    """Return what breaks the same thing several times, one after the other."""

    def repeat(flight: Lockstep, vehicle: str) -> None:
        for number in range(count):
            flight.at(flight.time_s + every_s * number, functools.partial(inject, flight, vehicle))

    return repeat


def stops(*names: str) -> Inject:
    """One kind of PX4's reports stops; the last one stays."""

    def inject(flight: Lockstep, vehicle: str) -> None:
        link = flight.agents[vehicle].link
        receive = link.receive

        def filtered(fields: dict[str, Any]) -> None:
            receive({name: value for name, value in fields.items() if name not in names})

        link.receive = filtered  # type: ignore[method-assign]

    return inject


def without_law(flight: Lockstep, name: str) -> None:
    """Let one vehicle fly without avoidance, and tell that its fleet is another one: somebody
    else's, or --law off.
    """
    shell = flight.agents[name]
    other = shell.fleet.with_law("off")
    control = shell.core.control
    control.params = pipeline_params(other, name)
    publish = shell.node.publish

    def change(topic: Topic, name: str, message: Message) -> None:
        if isinstance(message, Telemetry):
            message = msgspec.structs.replace(
                message, config_hash=other.config_hash, law=other.law.name
            )
        publish(topic, name, message)

    shell.node.publish = change  # type: ignore[method-assign]


def lies(lie: Callable[[StateMessage, int], dict[str, Any]]) -> Inject:
    """Let one vehicle fly as always, and tell the others something else about itself; ``lie`` gets
    the tick, too.
    """

    def inject(flight: Lockstep, name: str) -> None:
        node = flight.agents[name].node
        publish = node.publish

        def change(topic: Topic, name: str, message: Message) -> None:
            if isinstance(message, StateMessage):
                message = msgspec.structs.replace(
                    message, **lie(message, round(flight.time_s / 0.02))
                )
            publish(topic, name, message)

        node.publish = change  # type: ignore[method-assign]

    return inject


def _beside(message: StateMessage, _tick: int) -> dict[str, Any]:
    return _moved(message, 1.0)


def _moved(message: StateMessage, east_m: float) -> dict[str, Any]:
    names = "position_enu_m", "predicted_position_enu_m"
    return {name: (x + east_m, y, z) for name in names for x, y, z in (getattr(message, name),)}


def _stands(message: StateMessage, _tick: int) -> dict[str, Any]:
    still = (0.0, 0.0, 0.0)
    place = (0.0, -1.6, 0.0)
    speeds = (
        "velocity_enu_m_s",
        "acceleration_enu_m_s2",
        "predicted_velocity_enu_m_s",
        "intent_enu_m_s",
    )
    places = {"position_enu_m": place, "predicted_position_enu_m": place, "is_airborne": False}
    return dict.fromkeys((*speeds, "commanded_acceleration_enu_m_s2"), still) | places


def _teleports(message: StateMessage, tick: int) -> dict[str, Any]:
    return _moved(message, (0.0, 1.5, -1.0)[tick // 20 % 3])


LIES = {"a metre beside": _beside, "stands": _stands, "teleports": _teleports}


def order(verb: str) -> Inject:
    """An operator orders something of one vehicle in the middle of a mission; it may be refused."""

    def inject(flight: Lockstep, name: str) -> None:
        flight.client.submit_now(f"{verb} {name}")

    return inject


def order_outside(flight: Lockstep, name: str) -> None:
    """An operator orders a vehicle outside the fence: across an edge where the fleet has areas."""
    fence = flight.config.fleet.geofence_m
    areas = flight_space_of(flight.config).areas
    if areas:
        east_m, north_m = _beyond_edge(areas[0])
        up_m = min(max(0.5 * fence.z[1], areas[0].low_m), areas[0].high_m)
        _order_to(flight, name, (east_m, north_m, up_m))
        return

    _order_to(flight, name, (fence.x[1] + _BEYOND_M, fence.y[1] + _BEYOND_M, 0.5 * fence.z[1]))


def _beyond_edge(area: Area) -> Point:
    """Return a place where nobody may be: beyond a corner, or in the middle of what is kept out."""
    if area.radius_m:
        east, north = area.center_enu_m
        to_east_m = area.radius_m + _BEYOND_M if area.keeps_in else 0.0
        return east + to_east_m, north

    corners = area.corners_enu_m
    middle_east = sum(east for east, _ in corners) / len(corners)
    middle_north = sum(north for _, north in corners) / len(corners)
    if not area.keeps_in:
        return middle_east, middle_north

    farthest = max(corners, key=lambda corner: math.dist(corner, (middle_east, middle_north)))
    away_m = math.dist(farthest, (middle_east, middle_north))
    share = (away_m + _BEYOND_M) / away_m
    return (
        middle_east + share * (farthest[0] - middle_east),
        middle_north + share * (farthest[1] - middle_north),
    )


def order_above(flight: Lockstep, name: str) -> None:
    """An operator orders a vehicle to a place above the ceiling."""
    fence = flight.config.fleet.geofence_m
    middle_x = 0.5 * (fence.x[0] + fence.x[1])
    middle_y = 0.5 * (fence.y[0] + fence.y[1])
    _order_to(flight, name, (middle_x, middle_y, fence.z[1] + _BEYOND_M))


def order_into_another(flight: Lockstep, name: str) -> None:
    """An operator orders a vehicle to where another one is."""
    names = flight.config.enabled_names
    other = flight.simulation.names.index(names[(names.index(name) + 1) % len(names)])
    positions, _, _ = flight.simulation.emulator.world.truth_enu()
    east_m, north_m, up_m = positions[other].tolist()
    _order_to(flight, name, (east_m, north_m, max(up_m, _LEAST_HEIGHT_M)))


def _order_to(flight: Lockstep, name: str, place_enu_m: tuple[float, float, float]) -> None:
    """Order a vehicle to a place, which the ground or the vehicle may refuse."""
    east_m, north_m, up_m = place_enu_m
    with contextlib.suppress(OrderError):
        flight.client.submit_now(f"move {name} {east_m:.2f} {north_m:.2f} {up_m:.2f}")


def wind_rises(flight: Lockstep, name: str) -> None:
    """The wind rises to twice what the fleet may fly in, for everybody."""
    config = flight.config
    vehicles = [config.vehicles[one] for one in config.enabled_names]
    limit_m_s = min(wind_limit_m_s(config, vehicle) for vehicle in vehicles)
    speed_m_s = min(2.0 * limit_m_s, _STRONGEST_WIND_M_S)
    fault("wind_ramp", speed_m_s=speed_m_s, over_s=_WIND_RISES_IN_S)(flight, name)
