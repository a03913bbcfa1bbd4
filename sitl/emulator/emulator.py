"""Vehicles, estimates and autopilots in one world, advanced step by step.

Truth flows in a circle: world -> estimator -> autopilot -> world. What is published as ground truth
is a copy. There are no sockets and no clock: time is counted.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from msgspec.structs import replace

from sitl.emulator.fault_effects import Disturbances
from sitl.faults.catalogue import FAULT_KINDS, Fault, FaultError, check
from sitl.physics import frames
from sitl.physics.contacts import Collision, Downwash, World
from sitl.physics.earth import ZURICH, EarthPoint
from sitl.physics.frames import Array
from sitl.physics.vehicle import STEP_S, VehicleProfile
from sitl.physics.wind import WindSettings
from sitl.px4 import setpoints
from sitl.px4.commander import EmulatedPx4
from sitl.px4.estimator import (
    ESTIMATE_EVERY_STEPS,
    GPS_ACCURACIES_M,
    GPS_ACCURACY_M,
    GPS_LEVELS,
    Estimator,
)
from sitl.px4.estimator_errors import GPS, Source, vision_level
from sitl.px4.flight_log import FlightLogs
from sitl.px4.mode_control import TICK_S
from sitl.px4.parameters import Parameters
from sitl.px4.satellite_receiver import SatelliteReceiver
from sitl.px4.signals import Actuation, AutopilotInputs, Setpoint
from sitl.px4.signing import KeyStore
from sitl.px4.versions import DEFAULT, Version

_TICK_STEPS = round(TICK_S / STEP_S)
_SOME_DATE_S = 1.7e9
_NOW_S = 1e-9  # by which times may differ that are meant to be the same

# Bits of EKF2_EV_CTRL and EKF2_GPS_CTRL.
_USES_POSITION = 1
_USES_VELOCITY = 4
_USES_YAW = 8


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """One vehicle to emulate."""

    name: str
    system_id: int
    profile: VehicleProfile
    start_enu_m: tuple[float, float, float]
    px4: Version = DEFAULT  # of its PX4
    hover_time_s: float | None = None  # of a whole charge; None: as PX4's simulator has it


@dataclass(frozen=True, slots=True)
class Environment:
    """Wind and errors that act on all vehicles."""

    wind: WindSettings = field(default_factory=WindSettings)
    downwash: Downwash = field(default_factory=Downwash)
    has_common_errors: bool = False  # all estimates err alike, see :class:`Estimator`
    error_scale: float = 1.0  # of the random errors of the estimates
    # of the differences between vehicles of one type, see `sitl/physics/scatter.py`
    vehicle_scatter: float = 1.0


def _own_parameters(spec: VehicleSpec, origin: EarthPoint) -> dict[str, int | float]:
    """Return the parameters that are set where a vehicle is simulated."""
    own = {
        "MAV_SYS_ID": spec.system_id,
        "SIH_LOC_LAT0": origin.latitude_deg,
        "SIH_LOC_LON0": origin.longitude_deg,
        "SIH_LOC_H0": origin.altitude_m,
    }
    if spec.hover_time_s is not None:
        own["SIM_BAT_DRAIN"] = spec.hover_time_s
    return own


class Emulator:
    """Several PX4s and their vehicles.

    Args:
        specs: the vehicles, in order.
        body_diameter_m: see :class:`World`.
        environment: wind, downwash and errors; a calm room by default.
        origin: point of the Earth that is 0, 0, 0 of the frame in which the vehicles start.
        seed: seed of everything random.

    Attributes:
        disturbances: faults, present and to come; see :meth:`inject`.
        has_global_origin: per vehicle, somebody has said where on Earth its local frame lies.
        key_stores: per vehicle, the key of MAVLink signing.
        flight_logs: per vehicle, the logs on its card; None where nobody keeps any, see
            :meth:`keep_logs`.
        outside: begins and ends faults of bus and agents; None where there are none.
        receivers: per vehicle, its satellite receiver and the corrections that it has.
        unix_start_s: the date at the start, as PX4 knows it from its computer; by default any fixed
            one.
    """

    def __init__(
        self,
        specs: list[VehicleSpec],
        *,
        body_diameter_m: float = 0.5,
        environment: Environment | None = None,
        origin: EarthPoint = ZURICH,
        seed: int = 0,
    ) -> None:
        _compile_loops()
        environment = environment or Environment()
        self.specs = list(specs)
        self.origin = origin
        names = [spec.name for spec in specs]
        starts = [spec.start_enu_m for spec in specs]

        self.world = World(
            [spec.profile for spec in specs],
            np.array(starts, dtype=np.float64).reshape(-1, 3),
            body_diameter_m=body_diameter_m,
            seed=seed,
            wind=environment.wind,
            downwash=environment.downwash,
            names=names,
        )
        self.estimator = Estimator(
            self.world.vehicles.states.position_ned_m,
            seed=seed,
            is_common=environment.has_common_errors,
            scale=environment.error_scale,
            ground_altitude_m=origin.altitude_m,
        )
        self.autopilots = [
            EmulatedPx4(Parameters(spec.px4, _own_parameters(spec, origin))) for spec in specs
        ]
        for index in range(len(specs)):
            self._attitude_control_changed(index)

        self.disturbances = Disturbances(names, seed=seed)
        self.outside: Callable[[Fault, bool], None] | None = None
        self.key_stores = [KeyStore() for _ in specs]
        self.flight_logs: list[FlightLogs] | None = None
        self.has_global_origin = [False] * len(specs)
        self.unix_start_s = _SOME_DATE_S

        self._shown = np.zeros((len(specs), 4))  # newest external position and heading of each
        self._shown_resets = [0] * len(specs)  # newest reset counter of each
        # external positions that a fault delays: when they arrive, of which vehicle, what
        self._late_vision: list[tuple[float, int, Array]] = []
        self._applied: list[Actuation | None] = [None] * len(specs)
        self.receivers = [SatelliteReceiver() for _ in specs]
        self._base_shifts_m = [0.0] * len(specs)  # by which wrong bases move the estimates
        self._has_corrections = False  # somebody has sent some
        self._estimate()

    @property
    def time_s(self) -> float:
        """Simulated time since the start [s]."""
        return self.world.time_s

    def clock_s(self, index: int) -> float:
        """Return the time of an autopilot's clock: simulated time, unless a fault disturbs it."""
        return self.disturbances.clocks[index].at(self.time_s)

    def keep_logs(self) -> list[FlightLogs]:
        """Have every autopilot log its flights from now on; return their logs."""
        if self.flight_logs is None:
            self.flight_logs = [FlightLogs() for _ in self.specs]
        return self.flight_logs

    def inject(self, fault: Fault) -> Fault:
        """Plan a fault; return it with its defaults.

        A fault that should have begun already begins with the next step.

        Raises:
            FaultError: unknown, out of bounds, or in contradiction to another one.
        """
        self.check(fault)
        return self.disturbances.plan.add(fault, self.time_s)

    def check(self, fault: Fault) -> Fault:
        """Return the fault with its defaults; it is not planned.

        Raises:
            FaultError: unknown, out of bounds, or outside what is simulated here.
        """
        checked = check(fault, [spec.name for spec in self.specs])
        if FAULT_KINDS[fault.name].is_outside and self.outside is None:
            raise FaultError(
                f"{fault.name} is a fault of the bus or of an agent, which this flight does not "
                "simulate: fly it in lockstep, or remove the fault."
            )
        return checked

    def reboot(self, index: int) -> None:
        """Start an autopilot anew, wherever its vehicle is.

        Parameters and battery stay, all else is forgotten.
        """
        old = self.autopilots[index]
        new = EmulatedPx4(params=old.params, boot_time_s=self.clock_s(index), battery=old.battery)
        new.faults.extend(old.faults)
        self.autopilots[index] = new

        self.has_global_origin[index] = False
        self.estimator.restart(index, self.time_s, self.world.vehicles.states.position_ned_m[index])
        self.key_stores[index].restart()
        self.disturbances.boots[index] += 1

    def step(self) -> list[Collision]:
        """Advance everything by 4 ms."""
        if self.time_s + _NOW_S >= self.disturbances.plan.next_s:
            self.disturbances.advance(self)
        if self._late_vision:
            self._fuse_late_vision()

        if self.world.vehicles.steps % _TICK_STEPS == 0:
            self._tick()
        for index, autopilot in enumerate(self.autopilots):
            if autopilot.actuation is not self._applied[index]:
                self._apply(index, autopilot.actuation)

        collisions = self.world.step()
        if self.world.vehicles.steps % ESTIMATE_EVERY_STEPS == 0:
            self._estimate()
        return collisions

    def _tick(self) -> None:
        """Let every autopilot act on what it knows."""
        for index, shift_ned_m in self.estimator.jumps:
            self.autopilots[index].mode_control.frame_jumped(shift_ned_m)
        self.estimator.jumps.clear()

        # Inputs are kept by the autopilots: copies, not windows.
        states = self.world.vehicles.states
        positions = self.estimator.position_ned_m.copy()
        velocities = self.estimator.velocity_ned_m_s.copy()
        yaws_rad = frames.wrap(states.yaw_rad + self.estimator.yaw_error_rad)
        attitudes = frames.from_yaw_and_tilt(yaws_rad, states.tilt_rad)

        winds_m_s = np.hypot(*self.world.vehicles.air_ned_m_s[:, :2].T).tolist()

        for index, autopilot in enumerate(self.autopilots):
            if self.disturbances.is_hung[index]:
                continue

            source = self.estimator.source[index]
            inputs = AutopilotInputs(
                time_s=self.clock_s(index),
                position_ned_m=positions[index],
                velocity_ned_m_s=velocities[index],
                attitude=attitudes[index],
                yaw_rad=float(yaws_rad[index]),
                on_ground=bool(states.on_ground[index]),
                has_global_position=self._has_global_position(index, source),
                has_local_position=source is not Source.NONE,
                wind_m_s=winds_m_s[index],
            )
            autopilot.tick(inputs)
            if self.flight_logs is not None:
                unix_s = self.unix_start_s + self.time_s
                self.flight_logs[index].tick(autopilot, inputs, unix_s)

    def _has_global_position(self, index: int, source: Source) -> bool:
        # Satellites give it by themselves; a local position becomes one when somebody has said
        # where its origin is.
        if self.estimator.sees_satellites(index, self.time_s):
            return True
        return source is Source.VISION and self.has_global_origin[index]

    def believed_yaw_rad(self, index: int) -> float:
        """Return the heading with the compass's error [rad]."""
        true_yaw_rad = float(self.world.vehicles.states.yaw_rad[index])
        yaw_rad = true_yaw_rad + float(self.estimator.yaw_error_rad[index])
        return math.pi - (math.pi - yaw_rad) % (2.0 * math.pi)

    def attitude_setpoint(
        self,
        index: int,
        attitude_wxyz: list[float],
        rate_rad_s: list[float],
        thrust_frac: float,
        type_mask: int,
    ) -> None:
        """Take a SET_ATTITUDE_TARGET as PX4 does."""
        setpoint = setpoints.from_attitude(
            attitude_wxyz,
            rate_rad_s,
            thrust_frac,
            type_mask,
            now_s=self.clock_s(index),
            yaw_rad=self.believed_yaw_rad(index),
            version=self.autopilots[index].version,
        )
        if setpoint is not None:
            self.accept_setpoint(index, setpoint)

    def position_setpoint(self, index: int, fields: Mapping[str, Any]) -> None:
        """Take a SET_POSITION_TARGET_LOCAL_NED by MAVLink's field names."""
        now_s = self.clock_s(index)
        setpoint = setpoints.from_local(fields, now_s=now_s, yaw_rad=self.believed_yaw_rad(index))
        if isinstance(setpoint, Setpoint):
            self.accept_setpoint(index, setpoint)
            return

        journal = self.autopilots[index].journal
        if setpoint == "bad frame":
            frame = int(fields["coordinate_frame"])
            journal.say(now_s, setpoint, frame, frame=frame)
        else:
            journal.say(now_s, setpoint)

    def accept_setpoint(self, index: int, setpoint: Setpoint) -> None:
        """Hand a setpoint to its autopilot.

        A hung autopilot does not receive it; one with a fault receives it and does nothing.
        """
        if self.disturbances.is_hung[index]:
            return

        autopilot = self.autopilots[index]
        if self.disturbances.ignores_setpoints[index] and autopilot.setpoint is not None:
            setpoint = replace(autopilot.setpoint, time_s=setpoint.time_s)
        autopilot.accept_setpoint(setpoint)

    def corrections(self, index: int, flags: int, data: bytes) -> None:
        """Take a GPS_RTCM_DATA."""
        if self.disturbances.is_hung[index]:
            return
        self._has_corrections = True
        self.receivers[index].hear(flags, data, self.time_s)

    def fix_type(self, index: int) -> int:
        """Return GPS_RAW_INT.fix_type of a vehicle."""
        has_fix = self.estimator.sees_satellites(index, self.time_s)
        return self.receivers[index].fix_type(self.time_s, has_fix=has_fix)

    def _follow_fixes(self) -> None:
        """Let the estimates err as their fixes do, and go where their bases say."""
        estimator = self.estimator
        for index, receiver in enumerate(self.receivers):
            fix_type = self.fix_type(index)
            estimator.gps_levels[index] = GPS_LEVELS.get(fix_type, GPS)
            estimator.gps_accuracy_m[index] = GPS_ACCURACIES_M.get(fix_type, GPS_ACCURACY_M)

            # Where a base moves to does not matter to anybody here: all of it counts as north.
            shift_m = receiver.shift_m(self.time_s)
            if shift_m != self._base_shifts_m[index]:
                estimator.offset_ned_m[index, 0] += shift_m - self._base_shifts_m[index]
                self._base_shifts_m[index] = shift_m

    def vision(
        self,
        index: int,
        position_ned_m: Array,
        *,
        yaw_rad: float = math.nan,
        has_velocity: bool = False,
        reset_count: int = 0,
    ) -> None:
        """Take an external position (ODOMETRY, VISION_POSITION_ESTIMATE) if the parameters say so.

        Args:
            index: index of the vehicle.
            position_ned_m: (3,) where it is said to be.
            yaw_rad: heading that is sent with it; NaN: the true heading.
            has_velocity: whether a velocity came with it.
            reset_count: another one than before lets the estimator begin anew there.
        """
        is_used = bool(self.autopilots[index].params.integer("EKF2_EV_CTRL") & _USES_POSITION)
        if not is_used or self.disturbances.is_hung[index]:
            return

        if math.isnan(yaw_rad):
            yaw_rad = float(self.world.vehicles.states.yaw_rad[index])
        self._set_vision_level(index, has_velocity=has_velocity)

        self._shown[index, :3] = position_ned_m
        self._shown[index, 3] = yaw_rad
        if reset_count != self._shown_resets[index]:
            self._shown_resets[index] = reset_count
            self.estimator.begin_vision_anew(index)

        faults = self.disturbances.vision
        if faults.is_clear:
            self._fuse(index, self._shown[index])
            return
        if faults.is_lost(index):
            return

        shown = faults.apply(self._shown, self.time_s, index)[index]
        delay_s = faults.delay_s(index)
        if delay_s > 0.0:
            self._late_vision.append((self.time_s + delay_s, index, shown))
        else:
            self._fuse(index, shown)

    def _fuse(self, index: int, shown: Array) -> None:
        """Fuse an external position and heading (4,)."""
        delay_s = self.autopilots[index].params["EKF2_EV_DELAY"] / 1000.0
        yaw_error_rad = float(shown[3]) - float(self.world.vehicles.states.yaw_rad[index])
        self.estimator.fuse_vision(
            index, self.time_s, shown[:3], delay_s=delay_s, yaw_error_rad=yaw_error_rad
        )

    def _fuse_late_vision(self) -> None:
        late = self._late_vision
        self._late_vision = [entry for entry in late if entry[0] > self.time_s + _NOW_S]
        for arrival_s, index, shown in late:
            has_arrived = arrival_s <= self.time_s + _NOW_S
            if has_arrived and not self.disturbances.is_hung[index]:
                self._fuse(index, shown)

    def _set_vision_level(self, index: int, *, has_velocity: bool) -> None:
        params = self.autopilots[index].params
        uses_velocity = bool(params.integer("EKF2_EV_CTRL") & _USES_VELOCITY)
        self.estimator.vision_levels[index] = vision_level(
            params["EKF2_EVP_NOISE"],
            params["EKF2_TAU_VEL"],
            has_velocity=has_velocity and uses_velocity,
        )

    def parameters_changed(self, index: int) -> None:
        """Carry parameters over to where they act."""
        params = self.autopilots[index].params
        uses_satellites = bool(params.integer("EKF2_GPS_CTRL") & _USES_POSITION)
        has_receiver = params.integer("SYS_HAS_GPS") != 0
        uses_vision_yaw = bool(params.integer("EKF2_EV_CTRL") & _USES_YAW)

        self.estimator.has_gps[index] = uses_satellites and has_receiver
        self.estimator.uses_vision_yaw[index] = uses_vision_yaw
        self.estimator.vision_noise_m[index] = params["EKF2_EVP_NOISE"]
        self._set_vision_level(index, has_velocity=False)
        self._attitude_control_changed(index)

    def _attitude_control_changed(self, index: int) -> None:
        params = self.autopilots[index].params
        gains = (params["MC_ROLL_P"], params["MC_PITCH_P"])
        self.world.vehicles.set_attitude_control(index, gains, params.values.get("MC_REF_W_N", 0.0))

    def _estimate(self) -> None:
        if self._has_corrections:
            self._follow_fixes()
        states = self.world.vehicles.states
        self.estimator.step(
            self.time_s, states.position_ned_m, states.velocity_ned_m_s, states.on_ground
        )

    def _apply(self, index: int, actuation: Actuation) -> None:
        """Command an actuation to a vehicle.

        The autopilot steers in the heading and the level it believes in; the vehicle turns in those
        it has.
        """
        w, x, y, z = actuation.attitude.tolist()
        yaw_error_rad = float(self.estimator.yaw_error_rad[index])
        north_rad, east_rad = self.estimator.tilt_error_rad[index].tolist()
        headed = frames.turned((w, x, y, z), -yaw_error_rad)

        commands = self.world.commands
        commands.attitude[index] = frames.tilted(headed, north_rad, east_rad)
        commands.rate_rad_s[index] = actuation.rate_rad_s
        commands.is_rate[index] = actuation.is_rate
        commands.thrust_frac[index] = actuation.thrust_frac
        commands.motors_on[index] = actuation.motors_on
        self._applied[index] = actuation


@functools.cache
def _compile_loops() -> None:
    """Compile every loop before time runs: the first start on a machine takes seconds."""
    profile = VehicleProfile()
    world = World([profile, profile], np.array([[0.0, 0.0, 5.0], [3.0, 0.0, 5.0]]))
    world.step()
    states = world.vehicles.states
    estimator = Estimator(states.position_ned_m, seed=0)
    estimator.step(0.0, states.position_ned_m, states.velocity_ned_m_s, states.on_ground)
