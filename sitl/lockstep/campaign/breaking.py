"""How each fault of a campaign is injected into a lockstep flight.

An injection (``Inject``) is a function that is called during the flight, with the flight and the
name of the vehicle that is to suffer the fault. Functions here are injections, or return one.
``injections.py`` lists all of them, with what the vehicles have to notice.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Sequence
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

_BEYOND_M = 5.0  # distance outside the fence
_MIN_HEIGHT_M = 0.5  # of a goal that is the position of another vehicle
_TICK_S = 0.02  # period of the agents' ticks
_WIND_RISES_IN_S = 20.0
_STRONGEST_WIND_M_S = 30.0  # the most that the emulator accepts
_SLOW_DELAY_S = 0.4
_STARVED_FOR_S = 6.0
# times for which the ground stays away after vehicles have begun to land without it
_HANGS_LONGER_S = 8.0
_DEAD_LONGER_S = 16.0  # by then all vehicles have landed

Inject = Callable[[Lockstep, str], None]


def fault(kind: str, duration_s: float = 0.0, **parameters: float | str) -> Inject:
    """Return the injection of a fault of the emulator, as ``covey sitl --fault`` plans it."""

    def inject(flight: Lockstep, name: str) -> None:
        flight.inject(
            Fault(kind, name, at_s=flight.time_s, duration_s=duration_s, parameters=parameters)
        )

    return inject


def to_all_vehicles(inject_one: Inject) -> Inject:
    """Return an injection that does the same to all vehicles at once."""

    def inject(flight: Lockstep, _name: str) -> None:
        for name in flight.config.enabled_names:
            inject_one(flight, name)

    return inject


def swap(duration_s: float) -> Inject:
    """Return an injection: the motion capture confuses the vehicle with the next one."""

    def inject(flight: Lockstep, name: str) -> None:
        names = flight.config.enabled_names
        other = names[(names.index(name) + 1) % len(names)]
        fault("mocap_swapped", duration_s, other=other)(flight, name)

    return inject


def kill(flight: Lockstep, name: str) -> None:
    """Kill the agent, as by SIGKILL."""
    flight.agents[name].kill()


def kill_and_start(flight: Lockstep, name: str) -> None:
    """Kill the agent, and start a new one a second later."""
    flight.agents[name].kill()
    flight.at(flight.time_s + 1.0, flight.agents[name].start)


def hang(duration_s: float) -> Inject:
    """Return an injection: the agent's event loop stalls, forever if the time is infinite."""

    def inject(flight: Lockstep, name: str) -> None:
        flight.agents[name].hang()
        if math.isfinite(duration_s):
            flight.at(flight.time_s + duration_s, flight.agents[name].resume)

    return inject


def stop_agent(flight: Lockstep, name: str) -> None:
    """Ask the agent to stop, as by SIGTERM."""
    flight.agents[name].request_stop()


def cut(duration_s: float, *, keeps: tuple[str, ...] = (), all_agents: bool = False) -> Inject:
    """Return an injection that cuts the vehicle from all nodes.

    Args:
        duration_s: time after which the cut is healed.
        keeps: names of nodes whose connections with the vehicle stay.
        all_agents: whether every vehicle is cut off, and not only the given one.
    """

    def inject(flight: Lockstep, name: str) -> None:
        cut_names: Sequence[str] = (name,)
        if all_agents:
            cut_names = flight.config.enabled_names
        for cut_name in cut_names:
            for other in [*flight.config.enabled_names, GROUND, "sitl"]:
                if other != cut_name and other not in keeps:
                    flight.bus.cut(cut_name, other)
        flight.at(flight.time_s + duration_s, flight.bus.heal)

    return inject


def cut_ground(duration_s: float) -> Inject:
    """Return an injection: the ground is cut from all nodes, forever if the time is infinite."""

    def inject(flight: Lockstep, _name: str) -> None:
        flight.bus.partition([GROUND])
        if math.isfinite(duration_s):
            flight.at(flight.time_s + duration_s, flight.bus.heal)

    return inject


def slow_ground(flight: Lockstep, _name: str) -> None:
    """Delay every message between the ground and the vehicles for the rest of the flight."""
    for name in flight.config.enabled_names:
        flight.bus.set_link(GROUND, name, BusSettings(delay_s=_SLOW_DELAY_S))


def starve_ground(flight: Lockstep, _name: str) -> None:
    """Let the ground's event loop run only now and then, as on an overloaded computer."""
    rng = np.random.default_rng([round(flight.time_s / STEP_S), 20])
    begin_s = flight.time_s
    while begin_s < flight.time_s + _STARVED_FOR_S:
        gap_s = float(rng.uniform(0.1, 0.9))
        flight.at(begin_s, functools.partial(flight.hold_ground, gap_s))
        begin_s += gap_s + _TICK_S  # between two gaps the loop runs for a tick


def hang_ground(duration_s: float) -> Inject:
    """Return an injection: the ground is stopped by SIGSTOP, and continued after a time."""

    def inject(flight: Lockstep, _name: str) -> None:
        flight.hold_ground(duration_s, is_stopped=True)

    return inject


def hang_ground_for_long(flight: Lockstep, _name: str) -> None:
    """Stop the ground by SIGSTOP, and continue it only after vehicles have begun to land."""
    longest_s = flight.config.fleet.ground_lost_land_s + _HANGS_LONGER_S
    flight.hold_ground(longest_s, is_stopped=True)


def kill_ground(flight: Lockstep, _name: str) -> None:
    """End the ground's process: its connections close, and it does nothing more."""
    flight.bus.nodes[GROUND].stop()
    flight.hold_ground(flight.config.fleet.ground_lost_land_s + _DEAD_LONGER_S)


def bad_bus(flight: Lockstep, name: str) -> None:
    """Lose, delay, duplicate and reorder messages between the vehicle and the others."""
    bad = BusSettings(delay_s=0.01, jitter_s=0.02, loss=0.3, reorder=0.2, duplicate=0.2)
    for other in flight.config.enabled_names:
        if other != name:
            flight.bus.set_link(name, other, bad)


def pilot(mode: Mode) -> Inject:
    """Return an injection: a pilot, or another ground station, switches PX4 to a mode."""

    def inject(flight: Lockstep, name: str) -> None:
        emulator = flight.simulation.emulator
        px4 = emulator.autopilots[flight.simulation.names.index(name)]
        px4.request(emulator.time_s, mode)

    return inject


def tick_fails(count: int) -> Inject:
    """Return an injection: an internal error in the agent, so that some ticks have no result."""

    def inject(flight: Lockstep, name: str) -> None:
        def fail() -> None:
            core = flight.agents[name].core
            core.handle(
                agent_inputs.TickFailed("Internal error: ZeroDivisionError: injected."),
                flight.simulation.now_ns,
            )

        for number in range(count):
            flight.at(flight.time_s + _TICK_S * number, fail)

    return inject


_FAR_AHEAD = 2**60  # a sequence number that senders never reach
# a fleet file may not give a vehicle a name that begins with "watcher-"
_LIAR_NODE = "watcher-liar"


def nonsense(flight: Lockstep, name: str) -> None:
    """Publish bad states of another vehicle, and bad poses of all, for 1.2 seconds.

    Values are infinite, NaN, huge or repeated, have a sequence number far ahead, or belong to a
    vehicle that does not exist.
    """
    other = next(vehicle for vehicle in flight.config.enabled_names if vehicle != name)
    liar = flight.bus.node(_LIAR_NODE)
    liar.start()
    newest_state: StateMessage | None = None  # of the other vehicle

    def keep_newest(_topic: Topic, _name: str, message: object) -> None:
        nonlocal newest_state
        if isinstance(message, StateMessage) and message.sequence > 0:
            newest_state = message

    def publish_pose_ahead(_topic: Topic, _name: str, message: object) -> None:
        if isinstance(message, MocapPose) and message.sequence < _FAR_AHEAD:
            pose_ahead = msgspec.structs.replace(
                message, sequence=_FAR_AHEAD, stamp_ns=message.stamp_ns + 1
            )
            liar.publish(Topic.MOCAP, message.body, pose_ahead)

    liar.subscribe(Topic.STATE, other, keep_newest)
    for vehicle in flight.config.enabled_names:
        body = flight.config.vehicles[vehicle].body or vehicle
        liar.subscribe(Topic.MOCAP, body, publish_pose_ahead)
    bad_fields: tuple[dict[str, object], ...] = (
        {"position_enu_m": (math.nan, 0.0, 0.0)},
        {"velocity_enu_m_s": (math.inf, 0.0, 0.0)},
        {"sequence": -5, "position_enu_m": (1e300, 1e300, 1e300)},
        {"sequence": 0},
        {"sequence": _FAR_AHEAD},
        {"boot_id": _FAR_AHEAD, "sequence": _FAR_AHEAD},
        {"vehicle": "nobody", "position_enu_m": (0.0, 0.0, 1.0)},
        {"predicted_position_enu_m": (1e30, 0.0, 0.0)},
    )

    def publish_bad_state(number: int) -> None:
        if newest_state is not None:
            fields = bad_fields[number % len(bad_fields)]
            bad_state = msgspec.structs.replace(newest_state, **fields)
            liar.publish(Topic.STATE, bad_state.vehicle, bad_state)

    for number in range(120):
        flight.at(flight.time_s + 0.01 * number, functools.partial(publish_bad_state, number))
    flight.at(flight.time_s + 1.5, liar.stop)


def landed_state(duration_s: float, *, is_repeated: bool) -> Inject:
    """Return an injection: PX4 reports that it has landed, wherever it is.

    Args:
        duration_s: time for which true reports are replaced.
        is_repeated: whether the wrong report is repeated; otherwise it comes once, and no other
            landed state follows.
    """

    def inject(flight: Lockstep, name: str) -> None:
        link = flight.agents[name].link
        end_s = flight.time_s + duration_s
        receive = link.receive

        def change(fields: dict[str, Any]) -> None:
            if "landed" in fields and flight.time_s < end_s:
                fields = {key: value for key, value in fields.items() if key != "landed"}
                if is_repeated:  # otherwise no landed state reaches the agent
                    fields["landed"] = Landed.ON_GROUND
            receive(fields)

        link.receive = change  # type: ignore[method-assign]
        receive({"landed": Landed.ON_GROUND})

    return inject


# fields of one wrong report, as a stranger could send it in the name of a vehicle's PX4
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
    """Return the injection of one wrong report of PX4; the true reports go on as always."""

    def inject(flight: Lockstep, vehicle: str) -> None:
        link = flight.agents[vehicle].link
        fields = dict(WRONG_REPORTS[name])
        if "quaternion_enu_flu_wxyz" in fields:
            fields.setdefault("px4_boot_ms", link.snapshot().px4_boot_ms + 10)

        # It comes in the last step before a tick, after the true reports, so that the agent uses
        # the wrong one.
        steps = flight.simulation.emulator.world.vehicles.steps
        step_before_tick = steps + TICK_STEPS - 1 - steps % TICK_STEPS
        flight.at(STEP_S * step_before_tick, lambda: link.receive(fields))

    return inject


def some_wrong_report(flight: Lockstep, vehicle: str) -> None:
    """Inject one wrong report of PX4; the time of the flight decides which one."""
    tick = round(flight.time_s / _TICK_S)
    name = list(WRONG_REPORTS)[tick % len(WRONG_REPORTS)]
    wrong_report(name)(flight, vehicle)


def repeated(inject: Inject, count: int, every_s: float) -> Inject:
    """Return an injection that repeats another one several times."""

    def repeat(flight: Lockstep, vehicle: str) -> None:
        for number in range(count):
            flight.at(flight.time_s + every_s * number, functools.partial(inject, flight, vehicle))

    return repeat


def stops(*names: str) -> Inject:
    """Return an injection: some fields of PX4's reports stop arriving."""

    def inject(flight: Lockstep, vehicle: str) -> None:
        link = flight.agents[vehicle].link
        receive = link.receive

        def filtered(fields: dict[str, Any]) -> None:
            receive({name: value for name, value in fields.items() if name not in names})

        link.receive = filtered  # type: ignore[method-assign]

    return inject


def without_law(flight: Lockstep, vehicle: str) -> None:
    """Let one vehicle fly without avoidance, and announce the hash of a fleet file without law."""
    shell = flight.agents[vehicle]
    other = shell.fleet.with_law("off")
    control = shell.core.control
    control.params = pipeline_params(other, vehicle)
    publish = shell.node.publish

    def change(topic: Topic, name: str, message: Message) -> None:
        if isinstance(message, Telemetry):
            message = msgspec.structs.replace(
                message, config_hash=other.config_hash, law=other.law.name
            )
        publish(topic, name, message)

    shell.node.publish = change  # type: ignore[method-assign]


def lies(lie: Callable[[StateMessage, int], dict[str, Any]]) -> Inject:
    """Return an injection: a vehicle flies as always, but publishes wrong states from now on.

    Args:
        lie: returns the changed fields of a state message, given the true one and the tick.
    """

    def inject(flight: Lockstep, vehicle: str) -> None:
        node = flight.agents[vehicle].node
        publish = node.publish

        def change(topic: Topic, name: str, message: Message) -> None:
            if isinstance(message, StateMessage):
                message = msgspec.structs.replace(
                    message, **lie(message, round(flight.time_s / _TICK_S))
                )
            publish(topic, name, message)

        node.publish = change  # type: ignore[method-assign]

    return inject


def _beside(message: StateMessage, _tick: int) -> dict[str, Any]:
    """Lie that the vehicle is a metre east of its true position."""
    return _moved(message, 1.0)


def _moved(message: StateMessage, east_m: float) -> dict[str, Any]:
    moved = {}
    for name in ("position_enu_m", "predicted_position_enu_m"):
        x, y, z = getattr(message, name)
        moved[name] = (x + east_m, y, z)
    return moved


def _stands(message: StateMessage, _tick: int) -> dict[str, Any]:
    """Lie that the vehicle stands at one place on the ground."""
    zero = (0.0, 0.0, 0.0)
    position_enu_m = (0.0, -1.6, 0.0)
    return {
        "position_enu_m": position_enu_m,
        "predicted_position_enu_m": position_enu_m,
        "is_airborne": False,
        "velocity_enu_m_s": zero,
        "acceleration_enu_m_s2": zero,
        "predicted_velocity_enu_m_s": zero,
        "intent_enu_m_s": zero,
        "commanded_acceleration_enu_m_s2": zero,
    }


def _teleports(message: StateMessage, tick: int) -> dict[str, Any]:
    """Lie that the vehicle jumps to another position every 20 ticks."""
    jumps_east_m = (0.0, 1.5, -1.0)
    return _moved(message, jumps_east_m[tick // 20 % 3])


LIES = {"a metre beside": _beside, "stands": _stands, "teleports": _teleports}


def order(verb: str) -> Inject:
    """Return an injection: an operator gives an order to one vehicle; it may be refused."""

    def inject(flight: Lockstep, name: str) -> None:
        flight.client.submit_now(f"{verb} {name}")

    return inject


def order_outside(flight: Lockstep, name: str) -> None:
    """Order a vehicle outside the fence; in a fleet with areas, across the edge of the first."""
    fence = flight.config.fleet.geofence_m
    areas = flight_space_of(flight.config).areas
    _, fence_east_m = fence.x
    _, fence_north_m = fence.y
    _, fence_top_m = fence.z
    middle_up_m = 0.5 * fence_top_m
    if areas:
        area = areas[0]
        east_m, north_m = _beyond_edge(area)
        up_m = min(max(middle_up_m, area.low_m), area.high_m)
        _order_to(flight, name, (east_m, north_m, up_m))
        return

    goal_enu_m = (fence_east_m + _BEYOND_M, fence_north_m + _BEYOND_M, middle_up_m)
    _order_to(flight, name, goal_enu_m)


def _beyond_edge(area: Area) -> Point:
    """Return a forbidden position: outside an area to stay in, or inside one to stay out of."""
    if area.radius_m:
        east, north = area.center_enu_m
        if not area.keeps_in:
            return east, north
        return east + (area.radius_m + _BEYOND_M), north

    corners = area.corners_enu_m
    middle_east = sum(east for east, _ in corners) / len(corners)
    middle_north = sum(north for _, north in corners) / len(corners)
    if not area.keeps_in:
        return middle_east, middle_north

    farthest = max(corners, key=lambda corner: math.dist(corner, (middle_east, middle_north)))
    away_m = math.dist(farthest, (middle_east, middle_north))
    stretch = (away_m + _BEYOND_M) / away_m  # above 1: the position is beyond the corner
    farthest_east, farthest_north = farthest
    return (
        middle_east + stretch * (farthest_east - middle_east),
        middle_north + stretch * (farthest_north - middle_north),
    )


def order_above(flight: Lockstep, name: str) -> None:
    """Order a vehicle to a position above the ceiling of the fence."""
    fence = flight.config.fleet.geofence_m
    _, top_m = fence.z
    _order_to(flight, name, (0.5 * sum(fence.x), 0.5 * sum(fence.y), top_m + _BEYOND_M))


def order_into_another(flight: Lockstep, name: str) -> None:
    """Order a vehicle to the position of another one."""
    names = flight.config.enabled_names
    other = flight.simulation.names.index(names[(names.index(name) + 1) % len(names)])
    positions, _, _ = flight.simulation.emulator.world.truth_enu()
    east_m, north_m, up_m = positions[other].tolist()
    _order_to(flight, name, (east_m, north_m, max(up_m, _MIN_HEIGHT_M)))


def _order_to(flight: Lockstep, name: str, goal_enu_m: tuple[float, float, float]) -> None:
    """Order a vehicle to a position; the ground or the vehicle may refuse it."""
    east_m, north_m, up_m = goal_enu_m
    with contextlib.suppress(OrderError):
        flight.client.submit_now(f"move {name} {east_m:.2f} {north_m:.2f} {up_m:.2f}")


def wind_rises(flight: Lockstep, name: str) -> None:
    """Let the wind rise to twice the wind limit of the fleet; it blows for all vehicles."""
    config = flight.config
    vehicles = [config.vehicles[vehicle_name] for vehicle_name in config.enabled_names]
    limit_m_s = min(wind_limit_m_s(config, vehicle) for vehicle in vehicles)
    speed_m_s = min(2.0 * limit_m_s, _STRONGEST_WIND_M_S)
    fault("wind_ramp", speed_m_s=speed_m_s, over_s=_WIND_RISES_IN_S)(flight, name)
