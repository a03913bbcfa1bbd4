"""Injections of the fault suite: one row for each thing that can go wrong, and what has to be noticed of it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec

from onboard import events as ev
from onboard.autopilot import Landed
from onboard.bus.schema import Message, MocapPose, StateMessage, Telemetry
from onboard.bus.topics import Topic
from onboard.control.pipeline import pipeline_params
from onboard.safety.failsafe_table import Condition as C
from sitl.faults.catalogue import Fault
from sitl.lockstep.connections import BusSettings
from sitl.lockstep.flight import GROUND, Lockstep
from sitl.lockstep.simulation import TICK_STEPS
from sitl.physics.vehicle import STEP_S
from sitl.px4.modes import Mode

Inject = Callable[[Lockstep, str], None]


@dataclass(frozen=True, slots=True)
class Injection:
    """One thing that goes wrong.

    Args:
        own: conditions of which the vehicle has to notice at least one; others: at least one of the others.
        is_silenced: whether the vehicle stops avoiding, so that its pairs are reported by themselves.
        is_cut_off: whether the ground may not hear why until it is over.
        may_leave_fence: PX4 flies it alone, or nobody does.
        rises_m: how much higher the vehicle may get afterwards.
        is_falling: it tumbles to the ground faster than anybody can go aside; who flies above it has not been touched.
    """

    name: str
    inject: Inject
    own: frozenset[C] = frozenset()
    others: frozenset[C] = frozenset()
    is_silenced: bool = False
    is_cut_off: bool = False
    may_leave_fence: bool = False
    is_falling: bool = False
    rises_m: float = math.inf


def _fault(kind: str, duration_s: float = 0.0, **parameters: float | str) -> Inject:
    def inject(flight: Lockstep, name: str) -> None:
        flight.inject(Fault(kind, name, at_s=flight.time_s, duration_s=duration_s, parameters=parameters))

    return inject


def _of_all(inject_one: Inject) -> Inject:
    """The same for every vehicle at once: what they have in common fails."""

    def inject(flight: Lockstep, _name: str) -> None:
        for name in flight.config.enabled_names:
            inject_one(flight, name)

    return inject


def _swap(duration_s: float) -> Inject:
    def inject(flight: Lockstep, name: str) -> None:
        names = flight.config.enabled_names
        other = names[(names.index(name) + 1) % len(names)]
        _fault("mocap_swapped", duration_s, other=other)(flight, name)

    return inject


def _kill(flight: Lockstep, name: str) -> None:
    flight.agents[name].kill()


def _kill_and_start(flight: Lockstep, name: str) -> None:
    flight.agents[name].kill()
    flight.at(flight.time_s + 1.0, flight.agents[name].start)


def _hang(duration_s: float) -> Inject:
    def inject(flight: Lockstep, name: str) -> None:
        flight.agents[name].hang()
        if math.isfinite(duration_s):
            flight.at(flight.time_s + duration_s, flight.agents[name].resume)

    return inject


def _stop_agent(flight: Lockstep, name: str) -> None:
    flight.agents[name].request_stop()


def _cut(duration_s: float, *, keeps: tuple[str, ...] = (), all_agents: bool = False) -> Inject:
    """Cut the vehicle, or every agent, from all nodes but those it keeps."""

    def inject(flight: Lockstep, name: str) -> None:
        names = flight.config.enabled_names if all_agents else (name,)
        for one in names:
            for other in [*flight.config.enabled_names, GROUND, "sitl"]:
                if other != one and other not in keeps:
                    flight.bus.cut(one, other)
        flight.at(flight.time_s + duration_s, flight.bus.heal)

    return inject


def _lose_ground(flight: Lockstep, _name: str) -> None:
    flight.bus.partition([GROUND])
    flight.at(flight.time_s + 2.0, flight.bus.heal)


def _lose_ground_for_good(flight: Lockstep, _name: str) -> None:
    flight.bus.partition([GROUND])


def _bad_bus(flight: Lockstep, name: str) -> None:
    bad = BusSettings(delay_s=0.01, jitter_s=0.02, loss=0.3, reorder=0.2, duplicate=0.2)
    for other in flight.config.enabled_names:
        if other != name:
            flight.bus.set_link(name, other, bad)


def _pilot(mode: Mode) -> Inject:
    """Somebody at the transmitter, or another ground station, takes the vehicle."""

    def inject(flight: Lockstep, name: str) -> None:
        emulator = flight.simulation.emulator
        px4 = emulator.autopilots[flight.simulation.names.index(name)]
        px4.request(emulator.time_s, mode)

    return inject


def _tick_fails(count: int) -> Inject:
    """An error of our own: ticks without a result."""

    def inject(flight: Lockstep, name: str) -> None:
        def fail() -> None:
            core = flight.agents[name].core
            core.handle(ev.TickFailed("Internal error: ZeroDivisionError: injected."), flight.simulation.now_ns)

        for number in range(count):
            flight.at(flight.time_s + 0.02 * number, fail)

    return inject


_FAR_AHEAD = 2**60


def _nonsense(flight: Lockstep, name: str) -> None:
    """Send bad states and poses in the name of others: not finite, huge, repeated, numbered far ahead, of nobody."""
    other = next(one for one in flight.config.enabled_names if one != name)
    liar = flight.bus.node("liar")
    liar.start()
    heard: list[StateMessage] = []

    def listen(_topic: Topic, _name: str, message: object) -> None:
        if isinstance(message, StateMessage) and message.sequence > 0:
            heard[:] = [message]

    def number_ahead(_topic: Topic, _name: str, message: object) -> None:
        if isinstance(message, MocapPose) and message.sequence < _FAR_AHEAD:
            lie = msgspec.structs.replace(message, sequence=_FAR_AHEAD, stamp_ns=message.stamp_ns + 1)
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


def _landed_state(duration_s: float, *, is_repeated: bool) -> Inject:
    """PX4 reports the ground wherever it is: for a while, or its last report stays."""

    def inject(flight: Lockstep, name: str) -> None:
        link, end_s = flight.agents[name].link, flight.time_s + duration_s
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
        link, fields = flight.agents[vehicle].link, dict(WRONG_REPORTS[name])
        if "quaternion_enu_flu_wxyz" in fields:
            fields.setdefault("px4_boot_ms", link.snapshot().px4_boot_ms + 10)
        # after the true report of this tick and before the tick: the newest of a kind is the one that is read
        step_s, steps = STEP_S, flight.simulation.emulator.world.vehicles.steps
        flight.at(step_s * (steps + TICK_STEPS - 1 - steps % TICK_STEPS), lambda: link.receive(fields))

    return inject


def _some_wrong_report(flight: Lockstep, vehicle: str) -> None:
    """One wrong report, another one at each tick."""
    wrong_report(list(WRONG_REPORTS)[round(flight.time_s / 0.02) % len(WRONG_REPORTS)])(flight, vehicle)


def _repeated(inject: Inject, count: int, every_s: float) -> Inject:
    def repeat(flight: Lockstep, vehicle: str) -> None:
        for number in range(count):
            flight.at(flight.time_s + every_s * number, functools.partial(inject, flight, vehicle))

    return repeat


def _stops(*names: str) -> Inject:
    """One kind of PX4's reports stops; the last one stays."""

    def inject(flight: Lockstep, vehicle: str) -> None:
        link = flight.agents[vehicle].link
        receive = link.receive

        def filtered(fields: dict[str, Any]) -> None:
            receive({name: value for name, value in fields.items() if name not in names})

        link.receive = filtered  # type: ignore[method-assign]

    return inject


def _without_law(flight: Lockstep, name: str) -> None:
    """Let one vehicle fly without avoidance, and tell that its fleet is another one: somebody else's, or --law off."""
    shell = flight.agents[name]
    other, control = shell.fleet.with_law("off"), shell.core.control
    control.params, publish = pipeline_params(other, name), shell.node.publish

    def change(topic: Topic, vehicle: str, message: Message) -> None:
        if isinstance(message, Telemetry):
            message = msgspec.structs.replace(message, config_hash=other.config_hash, law=other.law.name)
        publish(topic, vehicle, message)

    shell.node.publish = change  # type: ignore[method-assign]


def _lies(lie: Callable[[StateMessage, int], dict[str, Any]]) -> Inject:
    """Let one vehicle fly as always, and tell the others something else about itself; ``lie`` gets the tick, too."""

    def inject(flight: Lockstep, name: str) -> None:
        node = flight.agents[name].node
        publish = node.publish

        def change(topic: Topic, vehicle: str, message: Message) -> None:
            if isinstance(message, StateMessage):
                message = msgspec.structs.replace(message, **lie(message, round(flight.time_s / 0.02)))
            publish(topic, vehicle, message)

        node.publish = change  # type: ignore[method-assign]

    return inject


def _beside(message: StateMessage, _tick: int) -> dict[str, Any]:
    return _moved(message, 1.0)


def _moved(message: StateMessage, east_m: float) -> dict[str, Any]:
    names = "position_enu_m", "predicted_position_enu_m"
    return {name: (x + east_m, y, z) for name in names for x, y, z in (getattr(message, name),)}


def _stands(message: StateMessage, _tick: int) -> dict[str, Any]:
    still, place = (0.0, 0.0, 0.0), (0.0, -1.6, 0.0)
    speeds = "velocity_enu_m_s", "acceleration_enu_m_s2", "predicted_velocity_enu_m_s", "intent_enu_m_s"
    places = {"position_enu_m": place, "predicted_position_enu_m": place, "is_airborne": False}
    return dict.fromkeys((*speeds, "commanded_acceleration_enu_m_s2"), still) | places


def _teleports(message: StateMessage, tick: int) -> dict[str, Any]:
    return _moved(message, (0.0, 1.5, -1.0)[tick // 20 % 3])


LIES = {"a metre beside": _beside, "stands": _stands, "teleports": _teleports}


def _order(verb: str) -> Inject:
    """An operator orders something of one vehicle in the middle of a mission; it may be refused."""

    def inject(flight: Lockstep, name: str) -> None:
        flight.client.submit_now(f"{verb} {name}")

    return inject


def _f(*conditions: C) -> frozenset[C]:
    return frozenset(conditions)


_POSITION = (C.POSITION_STALE, C.POSITION_LOST)
_SILENT = _f(C.NEIGHBOUR_SILENT, C.NEIGHBOUR_UNSEEN, C.NEIGHBOUR_STALE)

INJECTIONS: tuple[Injection, ...] = (
    Injection("mocap lost for good", _fault("mocap_lost"), _f(*_POSITION)),
    Injection("poses of all lost for good", _of_all(_fault("mocap_lost")), _f(*_POSITION)),
    Injection("poses of all lost for 0.5 s", _of_all(_fault("mocap_lost", 0.5)), _f(C.POSITION_STALE)),
    Injection("poses of all lost for 1.5 s", _of_all(_fault("mocap_lost", 1.5)), _f(*_POSITION)),
    Injection("mocap lost for 0.35 s", _fault("mocap_lost", 0.35), _f(*_POSITION)),
    Injection("mocap jumps for 0.4 s", _fault("mocap_jump", 0.4, east_m=1.0), _f(C.POSITION_JUMPED, C.MOCAP_SWAPPED)),
    Injection("mocap jumps for good", _fault("mocap_jump", north_m=-0.8),
              _f(C.POSITION_JUMPED, C.MOCAP_SWAPPED, *_POSITION)),
    Injection("mocap swaps two", _swap(1.0), _f(C.MOCAP_SWAPPED, C.POSITION_JUMPED, *_POSITION), is_silenced=True,
              may_leave_fence=True),
    Injection("mocap frozen for 0.3 s", _fault("mocap_frozen", 0.3), _f(C.MOCAP_FROZEN)),
    Injection("mocap frozen for good", _fault("mocap_frozen"), _f(C.MOCAP_FROZEN)),
    Injection("poses of all frozen for good", _of_all(_fault("mocap_frozen")), _f(C.MOCAP_FROZEN)),
    Injection("mocap 0.15 s late", _fault("mocap_late", 2.0, delay_s=0.15), _f(C.MOCAP_LATE, *_POSITION)),
    Injection("PX4 silent", _fault("link_loss", 1.0, share=1.0, direction="out"), _f(C.AUTOPILOT_SILENT),
              is_silenced=True, may_leave_fence=True),
    Injection("PX4 deaf", _fault("link_loss", share=1.0, direction="in"),
              _f(C.ATTITUDE_NOT_FOLLOWED, C.PX4_FAILSAFE, C.LEFT_OFFBOARD, C.THRUST_SATURATED), is_silenced=True,
              may_leave_fence=True),
    Injection("a tenth of the link lost", _fault("link_loss", share=0.1)),
    Injection("PX4 hangs for 0.6 s", _fault("autopilot_hang", 0.6),
              _f(C.AUTOPILOT_FROZEN, C.AUTOPILOT_SILENT, C.AUTOPILOT_BACK),
              is_silenced=True, may_leave_fence=True),
    Injection("PX4 reboots", _fault("autopilot_reboot"),
              _f(C.REBOOTED, C.DISARMED, C.AUTOPILOT_SILENT, C.AUTOPILOT_FROZEN),
              is_silenced=True, may_leave_fence=True),
    Injection("PX4's clock drifts", _fault("clock_drift", ms_per_s=-8.0)),
    Injection("PX4 ignores setpoints", _fault("setpoints_ignored"),
              _f(C.ATTITUDE_NOT_FOLLOWED, C.NOT_CLIMBING, C.FALLEN), is_silenced=True, may_leave_fence=True),
    Injection("a pilot takes over", _pilot(Mode.LOITER), _f(C.LEFT_OFFBOARD), is_silenced=True, may_leave_fence=True),
    Injection("a pilot lands", _pilot(Mode.LAND), _f(C.LEFT_OFFBOARD, C.PX4_FAILSAFE), is_silenced=True),
    Injection("agent killed", _kill, others=_SILENT, is_silenced=True, may_leave_fence=True),
    Injection("agent killed and started", _kill_and_start, others=_SILENT, is_silenced=True, may_leave_fence=True),
    Injection("agent hangs for 0.15 s", _hang(0.15), _f(C.LOOP_STALLED, C.LOOP_LATE)),
    Injection("agent hangs for 1 s", _hang(1.0), _f(C.LOOP_STALLED, C.LOOP_STALLED_LONG, C.PX4_FAILSAFE), _SILENT,
              is_silenced=True, may_leave_fence=True),
    Injection("agent hangs for good", _hang(math.inf), others=_SILENT, is_silenced=True, may_leave_fence=True),
    Injection("agent is asked to stop", _stop_agent, _f(C.SHUTDOWN)),
    Injection("ticks fail for 0.1 s", _tick_fails(5), _f(C.NOT_FINITE)),
    Injection("ticks fail for 1 s", _tick_fails(50), _f(C.NOT_FINITE, C.NOT_FINITE_LONG), is_silenced=True,
              may_leave_fence=True),
    Injection("cut off from all for 1 s", _cut(1.0), _f(*_POSITION, C.BUS_LOST), _SILENT, is_silenced=True,
              is_cut_off=True, may_leave_fence=True),
    Injection("cut off from all but the mocap", _cut(1.0, keeps=("sitl",)), _SILENT, _SILENT, is_cut_off=True),
    Injection("all cut apart, mocap stays", _cut(6.0, keeps=("sitl",), all_agents=True),
              _f(C.BUS_LOST, C.BUS_LOST_LONG, *_SILENT), is_cut_off=True),
    Injection("ground lost", _lose_ground, _f(C.GROUND_LOST), is_cut_off=True),
    Injection("ground lost for good", _lose_ground_for_good, _f(C.GROUND_LOST_LONG), _f(C.GROUND_LOST_LONG),
              is_cut_off=True),
    Injection("bad bus", _bad_bus),
    Injection("nonsense on the bus", _nonsense),
    Injection("battery cell fails", _fault("battery_cell", drop_pct=80.0),
              _f(C.BATTERY_LOW, C.BATTERY_FALLING, C.BATTERY_WARNING)),
    Injection("motor weak", _fault("motor_weak", 3.0, motor=2.0, effectiveness=0.85)),
    Injection("motor dead", _fault("motor_dead", motor=1.0),
              _f(C.ATTITUDE_NOT_FOLLOWED, C.NOT_CLIMBING, C.FALLEN, C.DISARMED, C.PX4_FAILSAFE, C.LEFT_OFFBOARD,
                 C.POSITION_JUMPED),  # from 0.25 m it hits the ground before anything else shows
              is_silenced=True, may_leave_fence=True, is_falling=True),
    Injection("PX4's own vision lost", _fault("vision_lost", 3.0)),
    Injection("PX4 reports the ground for 0.5 s", _landed_state(0.5, is_repeated=True)),
    Injection("PX4's last report of the ground stays", _landed_state(math.inf, is_repeated=False)),
    Injection("PX4's landed state stops", _stops("landed"), _f(C.LANDED_UNKNOWN)),
    Injection("PX4's battery reports stop", _stops("battery_frac", "battery_voltage_v")),
    Injection("one wrong report of PX4", _some_wrong_report),
    Injection("wrong reports of PX4 for 5 s", _repeated(wrong_report("another mode"), 9, 0.6),
              _f(C.REPORTS_CONTRADICT_LONG)),
    Injection("one flies without the law and says so", _without_law, others=_f(C.CONFIG_DIFFERS), is_silenced=True),
    *(Injection(f"one lies: {name}", _lies(lie), others=_f(C.NEIGHBOUR_IMPLAUSIBLE), is_silenced=True)
      for name, lie in LIES.items()),
    Injection("one is ordered to land", _order("land"), rises_m=0.35),
    Injection("one is ordered to hold", _order("hold"), rises_m=0.35),
    Injection("one is ordered to disarm", _order("disarm")),
)  # fmt: skip
