"""Effects of each fault of the catalogue on the emulator.

An effect is applied when the fault begins, and undone when the fault ends. The table of effects is
at the end of the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import Protocol

import numpy as np

from sitl.faults.catalogue import FAULT_KINDS, Fault, FaultPlan
from sitl.faults.lossy_channel import NO_FAULTS, ChannelFaults, LossyChannel
from sitl.faults.pose_faults import PoseFault, PoseFaults
from sitl.physics.random_streams import Stream
from sitl.physics.world import World
from sitl.px4.commander import EmulatedPx4
from sitl.px4.estimator import Estimator
from sitl.px4.modes import Mode
from sitl.px4.satellite_receiver import SatelliteReceiver
from sitl.px4.sticks import CENTRED

LINKS = ("companion", "ground")
DIRECTIONS = ("in", "out")
SIMULATOR_LINK = "simulator"  # link to viewers of the truth, which only a hang disturbs
_PILOT_MODES = {
    "posctl": Mode.POSCTL,
    "altctl": Mode.ALTCTL,
    "stabilized": Mode.STABILIZED,
    "hold": Mode.LOITER,
    "land": Mode.LAND,
}
_ARMING_REFUSED = "a fault forbids it"


class FaultyEmulator(Protocol):
    """The parts of the emulator that faults change."""

    world: World
    estimator: Estimator
    autopilots: list[EmulatedPx4]
    receivers: list[SatelliteReceiver]
    disturbances: Disturbances
    # begins (True) and ends faults of the bus and the agents; None: there are none
    outside: Callable[[Fault, bool], None] | None

    @property
    def time_s(self) -> float:
        """Simulated time [s]."""

    def reboot(self, index: int) -> None:
        """Restart one autopilot."""


@dataclass(slots=True)
class Clock:
    """The clock of an autopilot, which can drift and stop."""

    shown_s: float = 0.0  # time that the clock showed at its last change
    since_s: float = 0.0  # simulated time of its last change
    rate: float = 1.0  # seconds of the clock per simulated second
    is_stopped: bool = False

    def at(self, time_s: float) -> float:
        """Return the time that the clock shows at a simulated time."""
        if self.is_stopped:
            return self.shown_s
        return self.shown_s + self.rate * (time_s - self.since_s)

    def change(
        self, time_s: float, *, rate: float | None = None, is_stopped: bool | None = None
    ) -> None:
        """Change the rate of the clock, stop it or start it; None changes nothing."""
        self.shown_s = self.at(time_s)
        self.since_s = time_s
        if rate is not None:
            self.rate = rate
        if is_stopped is not None:
            self.is_stopped = is_stopped


class Disturbances:
    """Present faults of every vehicle.

    Attributes:
        plan: pending and active faults.
        wires: channels of each vehicle, by link and direction.
        mocap: faults of the poses that the motion capture delivers.
        vision: faults of the poses that the autopilots receive.
        clocks: clock of each autopilot.
        is_hung: whether each autopilot has stopped.
        ignores_setpoints: whether each autopilot ignores setpoints.
        boots: number of restarts of each autopilot.
        notices: sentences about faults that began or ended, since :meth:`take_notices`.
    """

    def __init__(self, names: list[str], *, seed: int) -> None:
        n = len(names)
        self.names = names
        self.plan = FaultPlan(names)
        self.wires = [_wires(seed, index) for index in range(n)]
        self.mocap = PoseFaults(n)
        self.vision = PoseFaults(n)
        self.clocks = [Clock() for _ in range(n)]
        self.is_hung = [False] * n
        self.ignores_setpoints = [False] * n
        self.boots = [0] * n
        self.notices: list[str] = []

    def advance(self, emulator: FaultyEmulator) -> None:
        """Begin and end the faults that are due."""
        begins, ends = self.plan.advance(emulator.time_s)
        for fault in ends:
            _apply(emulator, fault, is_on=False)
            self.notices.append(f"fault over: {fault.sentence}")
        for fault in begins:
            _apply(emulator, fault, is_on=True)
            self.notices.append(f"fault: {fault.sentence}")

    def take_notices(self) -> list[str]:
        """Return a sentence for each fault that began or ended since the last call."""
        notices = self.notices
        self.notices = []
        return notices


def _wires(seed: int, index: int) -> dict[tuple[str, str], LossyChannel[bytes]]:
    """Return the channels of one vehicle by link and direction, each with its own seed."""
    names = product((*LINKS, SIMULATOR_LINK), DIRECTIONS)
    return {
        name: LossyChannel([seed, Stream.WIRES, index, number]) for number, name in enumerate(names)
    }


def _apply(emulator: FaultyEmulator, fault: Fault, *, is_on: bool) -> None:
    """Begin or end a fault."""
    index = emulator.disturbances.names.index(fault.vehicle)
    family, _, kind = fault.name.partition("_")

    if family in ("mocap", "vision"):
        pose_fault = None  # ends the fault
        if is_on:
            pose_fault = _pose_fault(emulator, fault, family, kind)
        faults: PoseFaults = getattr(emulator.disturbances, family)
        faults.set(index, pose_fault)
    elif family == "link":
        _disturb_wires(emulator, index, fault, kind, is_on=is_on)
    else:
        _EFFECTS[fault.name](emulator, index, fault, is_on)


def _pose_fault(emulator: FaultyEmulator, fault: Fault, family: str, kind: str) -> PoseFault:
    """Return the errors of poses that a fault of the motion capture or of vision causes."""
    if kind == "swapped":
        other = emulator.disturbances.names.index(fault.word("other"))
        return PoseFault(kind, other=other)

    if kind == "jump":
        east_m = fault.number("east_m")
        north_m = fault.number("north_m")
        up_m = fault.number("up_m")
        # The motion capture measures in the fleet's ENU, an autopilot receives NED.
        if family == "mocap":
            return PoseFault(kind, shift_m=(east_m, north_m, up_m))
        return PoseFault(kind, shift_m=(north_m, east_m, -up_m))

    if kind in ("turned", "flipped"):
        return PoseFault(kind, yaw_rad=math.radians(fault.number("yaw_deg")))
    if kind == "drift":
        drift_m_s = (fault.number("east_m_s"), fault.number("north_m_s"), fault.number("up_m_s"))
        return PoseFault(kind, drift_m_s=drift_m_s, since_s=emulator.time_s)
    if kind == "late":
        return PoseFault(kind, delay_s=fault.number("delay_s"))
    return PoseFault(kind)


def _disturb_wires(
    emulator: FaultyEmulator, index: int, fault: Fault, kind: str, *, is_on: bool
) -> None:
    """Change the faults of the channels of a vehicle's links, or reset them at the end."""
    links: tuple[str, ...] = (fault.word("link"),)
    if links == ("both",):
        links = LINKS
    directions: tuple[str, ...] = (fault.word("direction"),)
    if directions == ("both",):
        directions = DIRECTIONS

    values: dict[str, float]  # changed fields of ChannelFaults
    if kind == "delay":
        values = {"delay_s": fault.number("delay_s"), "jitter_s": fault.number("jitter_s")}
    elif kind == "reorder":
        values = {"reorder": fault.number("share"), "reorder_s": fault.number("by_s")}
    else:  # "loss" and "duplicate", which are also the names of the fields
        values = {kind: fault.number("share")}
    if not is_on:
        values = {name: getattr(NO_FAULTS, name) for name in values}

    for link in links:
        for direction in directions:
            channel = emulator.disturbances.wires[index][link, direction]
            changed: ChannelFaults = replace(channel.faults, **values)
            if changed == NO_FAULTS:
                changed = NO_FAULTS  # LossyChannel.is_clear compares the object
            channel.faults = changed


def _motor(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    effectiveness = 1.0
    if is_on and fault.name == "motor_weak":
        effectiveness = fault.number("effectiveness")
    elif is_on:
        effectiveness = 0.0
    emulator.world.vehicles.set_motor(index, int(fault.number("motor")), effectiveness)


def _battery_cell(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    """Take away charge at once, and do not let it come back; the fault has no end."""
    emulator.autopilots[index].battery.lose(0.01 * fault.number("drop_pct"))


def _gps_loss(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    emulator.estimator.sensors[index].gps_blocked = is_on


def _gps_late(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    delay_s = 0.0
    if is_on:
        delay_s = fault.number("delay_s")
    emulator.estimator.sensors[index].gps_delay_s = delay_s


def _gps_drift(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    drift_ned_m_s = None
    if is_on:
        drift_ned_m_s = np.array(
            [fault.number("north_m_s"), fault.number("east_m_s"), -fault.number("up_m_s")]
        )
    emulator.estimator.sensors[index].gps_drift_ned_m_s = drift_ned_m_s


def _corrections_lost(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    emulator.receivers[index].is_deaf = is_on


def _rtk_lost(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    emulator.receivers[index].is_obstructed = is_on


def _corrections_garbled(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    emulator.receivers[index].is_garbled = is_on


def _hang(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    disturbances = emulator.disturbances
    disturbances.is_hung[index] = is_on
    disturbances.clocks[index].change(emulator.time_s, is_stopped=is_on)
    for link in (*LINKS, SIMULATOR_LINK):
        # Messages that arrive meanwhile wait in the socket. They are read when the process
        # continues.
        disturbances.wires[index][link, "in"].is_held = is_on


def _reboot(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    """Restart the autopilot at once; the fault has no end."""
    emulator.reboot(index)


def _clock_drift(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    rate = 1.0
    if is_on:
        rate = 1.0 + 1e-3 * fault.number("ms_per_s")
    emulator.disturbances.clocks[index].change(emulator.time_s, rate=rate)


def _arming(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    obstacles = emulator.autopilots[index].faults
    if is_on:
        obstacles.append(_ARMING_REFUSED)
    elif _ARMING_REFUSED in obstacles:
        obstacles.remove(_ARMING_REFUSED)


def _setpoints(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    emulator.disturbances.ignores_setpoints[index] = is_on


def _wind_ramp(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    """Ramp the wind up when the fault begins, and back down as fast when it ends."""
    wind = emulator.world.wind
    over_s = fault.number("over_s")
    if not is_on:
        wind.change_mean(wind.settings.mean_enu_m_s, over_s)
        return

    # A bearing counts clockwise from north. It is the direction from which the wind blows.
    speed_m_s = fault.number("speed_m_s")
    from_rad = math.radians(fault.number("from_deg"))
    east_m_s = -speed_m_s * math.sin(from_rad)
    north_m_s = -speed_m_s * math.cos(from_rad)
    wind.change_mean((east_m_s, north_m_s, 0.0), over_s)


def _pilot(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    px4 = emulator.autopilots[index]
    # At the end of the fault the sticks are no longer received, and the mode stays.
    px4.held_sticks = None
    if not is_on:
        return

    # PX4 accepts a manual mode only while sticks are received, so they are lost after the request.
    now_s = emulator.disturbances.clocks[index].at(emulator.time_s)
    px4.take_sticks(now_s, CENTRED)
    if fault.word("sticks") == "heard":
        px4.held_sticks = CENTRED
    px4.request(now_s, _PILOT_MODES[fault.word("mode")])


def _outside(emulator: FaultyEmulator, index: int, fault: Fault, is_on: bool) -> None:
    if emulator.outside is not None:
        emulator.outside(fault, is_on)


# Name of a fault -> its effect: (emulator, index of the vehicle, fault, whether it begins).
_EFFECTS: dict[str, Callable[[FaultyEmulator, int, Fault, bool], None]] = {
    "motor_weak": _motor,
    "motor_dead": _motor,
    "battery_cell": _battery_cell,
    "gps_loss": _gps_loss,
    "gps_late": _gps_late,
    "gps_drift": _gps_drift,
    "corrections_lost": _corrections_lost,
    "corrections_garbled": _corrections_garbled,
    "rtk_lost": _rtk_lost,
    "autopilot_hang": _hang,
    "autopilot_reboot": _reboot,
    "clock_drift": _clock_drift,
    "arming_refused": _arming,
    "setpoints_ignored": _setpoints,
    "wind_ramp": _wind_ramp,
    "pilot": _pilot,
    **{name: _outside for name, kind in FAULT_KINDS.items() if kind.is_outside},
}
