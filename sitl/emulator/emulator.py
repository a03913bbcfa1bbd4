"""Vehicles, estimates and autopilots in one world, advanced step by step.

In each step, data flow from the world to the estimator, to the autopilots and back to the world.
There are no sockets here. Time is counted in steps and does not come from a clock.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from msgspec.structs import replace

from sitl.emulator import odometry
from sitl.emulator.fault_effects import Disturbances
from sitl.faults.catalogue import FAULT_KINDS, Fault, FaultError, check
from sitl.physics import frames
from sitl.physics.contacts import Collision, Downwash
from sitl.physics.earth import ZURICH, EarthPoint, degrees_at
from sitl.physics.frames import Array
from sitl.physics.vehicle import STEP_S, VehicleProfile
from sitl.physics.wind import WindSettings
from sitl.physics.world import World
from sitl.px4 import setpoints
from sitl.px4.commander import EmulatedPx4
from sitl.px4.estimator import (
    ESTIMATE_EVERY_STEPS,
    GPS_ACCURACIES_M,
    GPS_LEVELS,
    Estimator,
)
from sitl.px4.estimator_errors import GPS, Source, vision_level
from sitl.px4.flight_log import FlightLogs
from sitl.px4.mode_control import TICK_S
from sitl.px4.modes import Mode
from sitl.px4.parameters import Parameters
from sitl.px4.satellite_receiver import SatelliteReceiver
from sitl.px4.signals import Actuation, AutopilotInputs, Setpoint
from sitl.px4.signing import KeyStore
from sitl.px4.vehicle_estimate import GPS_ACCURACY_M
from sitl.px4.versions import DEFAULT, Version

_TICK_STEPS = round(TICK_S / STEP_S)
_DEFAULT_DATE_S = 1.7e9  # date at the start of an emulator without a clock [Unix time]
_ODOMETRY_STEPS = round(odometry.PERIOD_S / STEP_S)
_TIME_TOLERANCE_S = 1e-9  # times that differ by less count as equal
_NEW_SETPOINT_S = 0.2  # age up to which a setpoint is new; they come every 20 ms

# Bounds of the altitude of a local frame.
_LOWEST_ORIGIN_M = -12_000.0
_HIGHEST_ORIGIN_M = 100_000.0

# Bits of EKF2_EV_CTRL and EKF2_GPS_CTRL.
_USES_POSITION = 1
_USES_VELOCITY = 4
_USES_YAW = 8

_HEADING_GATE_SIGMAS = 2.6  # EKF2_HDG_GATE
_LEAST_HEADING_NOISE_RAD = 0.01  # ev_yaw_control.cpp counts on no smaller one
# Shares of a difference by which one heading of a camera corrects the estimate, the second where
# its noise counts as a variance. PX4 v1.16 followed a turn of 40 degrees within some 5 s.
_HEADING_GAIN = 0.1
_HEADING_GAIN_OF_VARIANCE = 0.01


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """One vehicle to emulate."""

    name: str
    system_id: int
    profile: VehicleProfile
    start_enu_m: tuple[float, float, float]  # where it stands
    px4: Version = DEFAULT  # version of its PX4
    # Time that a full battery hovers; None: the time of PX4's simulator.
    hover_time_s: float | None = None
    # Lowest charge of its battery; None: that of PX4's simulator.
    least_charge_pct: float | None = None
    has_camera: bool = False  # whether a camera on board sends visual odometry to its PX4


@dataclass(frozen=True, slots=True)
class Environment:
    """Wind and errors that act on all vehicles."""

    wind: WindSettings = field(default_factory=WindSettings)
    downwash: Downwash = field(default_factory=Downwash)
    # Whether all estimates have the same error, see :class:`Estimator`.
    has_common_errors: bool = False
    error_scale: float = 1.0  # scale of the random errors of the estimates
    # Scale of the differences between vehicles of one type, see `sitl/physics/scatter.py`.
    vehicle_scatter: float = 1.0


class LateVision(NamedTuple):
    """One external position that has not arrived yet."""

    arrival_s: float
    vehicle_index: int
    pose: Array  # position and heading (4,)
    reset_count: int


def _simulation_parameters(spec: VehicleSpec, origin: EarthPoint) -> dict[str, int | float]:
    """Return the values of PX4's parameters that the simulation of a vehicle sets."""
    values = {
        "MAV_SYS_ID": spec.system_id,
        "SIH_LOC_LAT0": origin.latitude_deg,
        "SIH_LOC_LON0": origin.longitude_deg,
        "SIH_LOC_H0": origin.altitude_m,
    }
    if spec.hover_time_s is not None:
        values["SIM_BAT_DRAIN"] = spec.hover_time_s
    if spec.least_charge_pct is not None:
        values["SIM_BAT_MIN_PCT"] = spec.least_charge_pct
    return values


class Emulator:
    """Several PX4s and their vehicles.

    Args:
        specs: the vehicles, in order.
        body_diameter_m: diameter of a body, see :class:`World`.
        environment: wind, downwash and errors; by default the air is calm.
        origin: point on Earth of the origin of the frame in which the vehicles start.
        spots_enu_m: take-off spots (k, 3), which tell the ground, see :class:`World`; None: the
            starts of the vehicles.
        seed: seed of all random numbers.

    Attributes:
        disturbances: present and future faults, see :meth:`inject`.
        has_global_origin: whether each vehicle has received the position of its local frame on
            Earth.
        local_origins: latitude and longitude of the local frame of each vehicle: where its
            autopilot started, or as received. The altitude is that of the ground; the estimator has
            the one of the frame.
        key_stores: store of the key of MAVLink signing, per vehicle.
        flight_logs: logs on the card of each vehicle; None unless :meth:`keep_logs` was called.
        outside: function that begins and ends faults of bus and agents; None where there is neither
            a bus nor an agent.
        receivers: satellite receiver of each vehicle, with the corrections that it has received.
        unix_start_s: date at the start, which PX4 gets from its computer; by default a fixed date.
    """

    def __init__(
        self,
        specs: list[VehicleSpec],
        *,
        body_diameter_m: float = 0.5,
        environment: Environment | None = None,
        origin: EarthPoint = ZURICH,
        spots_enu_m: Array | None = None,
        seed: int = 0,
    ) -> None:
        _compile_loops()
        if environment is None:
            environment = Environment()
        self.specs = list(specs)
        self.origin = origin
        names = [spec.name for spec in specs]
        starts_enu_m = np.array([spec.start_enu_m for spec in specs], dtype=np.float64)
        starts_enu_m = starts_enu_m.reshape(-1, 3)
        if spots_enu_m is None:
            spots_enu_m = starts_enu_m

        self.world = World(
            [spec.profile for spec in specs],
            starts_enu_m,
            body_diameter_m=body_diameter_m,
            seed=seed,
            wind=environment.wind,
            downwash=environment.downwash,
            names=names,
            spots_enu_m=spots_enu_m,
        )
        self.estimator = Estimator(
            self.world.vehicles.states.position_ned_m,
            seed=seed,
            is_common=environment.has_common_errors,
            scale=environment.error_scale,
            ground_altitude_m=origin.altitude_m,
        )
        self.autopilots = [
            EmulatedPx4(Parameters(spec.px4, _simulation_parameters(spec, origin)))
            for spec in specs
        ]
        for index in range(len(specs)):
            self._attitude_control_changed(index)

        self.disturbances = Disturbances(names, seed=seed)
        self.outside: Callable[[Fault, bool], None] | None = None
        self.key_stores = [KeyStore() for _ in specs]
        self.flight_logs: list[FlightLogs] | None = None
        self.has_global_origin = [False] * len(specs)
        self.local_origins = [self.start_on_earth(index) for index in range(len(specs))]
        self.unix_start_s = _DEFAULT_DATE_S

        self._with_cameras = [index for index, spec in enumerate(specs) if spec.has_camera]
        self._odometry = odometry.VisualOdometry(
            self.world.vehicles.states.position_ned_m[self._with_cameras], seed=seed
        )
        # Newest external position and heading of each vehicle.
        self._vision_poses = np.zeros((len(specs), 4))
        # Reset counter of the newest external position that has arrived, per vehicle.
        self._vision_resets = [0] * len(specs)
        self._late_vision: list[LateVision] = []  # external positions that a fault delays
        self._applied: list[Actuation | None] = [None] * len(specs)
        self.receivers = [SatelliteReceiver() for _ in specs]
        # Shift of each estimate by a base station that reports a wrong position.
        self._base_shifts_m = [0.0] * len(specs)
        self._has_corrections = False  # whether corrections have ever been received
        self._estimate()

    @property
    def time_s(self) -> float:
        """Simulated time since the start [s]."""
        return self.world.time_s

    def start_on_earth(self, index: int) -> EarthPoint:
        """Return the point on Earth where a vehicle started."""
        east_m, north_m, _ = self.specs[index].start_enu_m
        return self._on_earth(north_m, east_m)

    def _on_earth(self, north_m: float, east_m: float) -> EarthPoint:
        """Return a point of the ground on Earth."""
        latitude_deg, longitude_deg = degrees_at(self.origin, north_m, east_m)
        return EarthPoint(latitude_deg, longitude_deg, self.origin.altitude_m)

    def clock_s(self, index: int) -> float:
        """Return the time of an autopilot's clock: simulated time, unless a fault disturbs it."""
        return self.disturbances.clocks[index].at(self.time_s)

    def keep_logs(self) -> list[FlightLogs]:
        """Start the logs of all autopilots; return them."""
        if self.flight_logs is None:
            self.flight_logs = [FlightLogs() for _ in self.specs]
        return self.flight_logs

    def inject(self, fault: Fault) -> Fault:
        """Plan a fault; return it with its defaults.

        A fault whose time has passed begins with the next step.

        Raises:
            FaultError: the fault is unknown, out of bounds, or contradicts another one.
        """
        self.check(fault)
        return self.disturbances.plan.add(fault, self.time_s)

    def check(self, fault: Fault) -> Fault:
        """Return the fault with its defaults, without planning it.

        Raises:
            FaultError: the fault is unknown, out of bounds, or of a part that is not simulated.
        """
        checked = check(fault, [spec.name for spec in self.specs])
        if FAULT_KINDS[fault.name].is_outside and self.outside is None:
            raise FaultError(
                f"{fault.name} is a fault of the bus or of an agent, which this flight does not "
                "simulate: fly it in lockstep, or remove the fault."
            )
        return checked

    def reboot(self, index: int) -> None:
        """Restart an autopilot, on the ground or in the air.

        It keeps its parameters and the state of its battery. Its faults and its pilot remain. The
        number of the vehicle is that of the simulation again, as PX4's own simulators start with.
        """
        old = self.autopilots[index]
        old.params.values["MAV_SYS_ID"] = self.specs[index].system_id
        new = EmulatedPx4(
            params=old.params,
            boot_time_s=self.clock_s(index),
            battery=old.battery,
            faults=list(old.faults),
            held_sticks=old.held_sticks,
        )
        self.autopilots[index] = new

        self.has_global_origin[index] = False
        north_m, east_m, _ = self.world.vehicles.states.position_ned_m[index].tolist()
        self.local_origins[index] = self._on_earth(north_m, east_m)
        self.estimator.restart(index, self.time_s, self.world.vehicles.states.position_ned_m[index])
        self.key_stores[index].restart()
        if self.flight_logs is not None:
            self.flight_logs[index].restart()
        self.disturbances.boots[index] += 1

    def step(self) -> list[Collision]:
        """Advance the world and all autopilots by 4 ms; return the new collisions."""
        if self.time_s + _TIME_TOLERANCE_S >= self.disturbances.plan.next_s:
            self.disturbances.advance(self)
        if self._late_vision:
            self._fuse_late_vision()

        if self.world.vehicles.steps % _TICK_STEPS == 0:
            self._tick()
        for index, autopilot in enumerate(self.autopilots):
            if autopilot.actuation is not self._applied[index]:
                self._apply(index, autopilot.actuation)

        collisions = self.world.step()
        if self._with_cameras and self.world.vehicles.steps % _ODOMETRY_STEPS == 0:
            self._send_odometry()
        if self.world.vehicles.steps % ESTIMATE_EVERY_STEPS == 0:
            self._estimate()
        return collisions

    def _tick(self) -> None:
        """Run one tick of every autopilot on the present estimates."""
        for index, shift_ned_m in self.estimator.jumps:
            self.autopilots[index].mode_control.frame_jumped(shift_ned_m)
        self.estimator.jumps.clear()

        # These are copies, because the autopilots store their inputs.
        states = self.world.vehicles.states
        positions = self.estimator.position_ned_m.copy()
        velocities = self.estimator.velocity_ned_m_s.copy()
        yaws_rad = frames.wrap(states.yaw_rad + self.estimator.yaw_error_rad)
        attitudes = frames.from_yaw_and_tilt(yaws_rad, states.tilt_rad)

        winds_m_s = np.hypot(*self.world.vehicles.air_ned_m_s[:, :2].T).tolist()

        for index, autopilot in enumerate(self.autopilots):
            if self.disturbances.is_hung[index]:
                continue

            source = self.estimator.source(index)
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

    def set_global_origin(self, index: int, received: EarthPoint) -> None:
        """Use the position of a local frame on Earth (SET_GPS_GLOBAL_ORIGIN).

        PX4 ignores a position that is not on Earth, and an altitude far from it. A frame by
        satellites keeps its latitude and longitude here; in PX4 it moves.
        """
        if abs(received.latitude_deg) > 90.0 or abs(received.longitude_deg) > 180.0:
            return

        self.has_global_origin[index] = True
        if not self.estimator.sensors[index].has_gps:
            self.local_origins[index] = received._replace(altitude_m=self.origin.altitude_m)
        if _LOWEST_ORIGIN_M < received.altitude_m < _HIGHEST_ORIGIN_M:
            self.estimator.set_origin_altitude(index, received.altitude_m)

    def _has_global_position(self, index: int, source: Source) -> bool:
        # Satellites give a global position directly. A local position gives one as soon as the
        # position of its origin on Earth is known.
        if self.estimator.sees_satellites(index, self.time_s):
            return True
        return source is Source.VISION and self.has_global_origin[index]

    def believed_yaw_rad(self, index: int) -> float:
        """Return the heading with the compass's error [rad]."""
        true_yaw_rad = float(self.world.vehicles.states.yaw_rad[index])
        yaw_rad = true_yaw_rad + float(self.estimator.yaw_error_rad[index])
        return math.pi - (math.pi - yaw_rad) % (2.0 * math.pi)  # in (-pi, pi]

    def attitude_setpoint(
        self,
        index: int,
        attitude_wxyz: list[float],
        rate_rad_s: list[float],
        thrust_frac: float,
        type_mask: int,
    ) -> None:
        """Accept or ignore a SET_ATTITUDE_TARGET as PX4 does."""
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
        """Accept or ignore a SET_POSITION_TARGET_LOCAL_NED as PX4 does.

        Args:
            index: index of the vehicle.
            fields: fields of the message by MAVLink's names.
        """
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
        """Deliver a setpoint to an autopilot.

        A hung autopilot does not receive it. An autopilot with the fault setpoints_ignored receives
        it but keeps the previous setpoint.
        """
        if self.disturbances.is_hung[index]:
            return

        autopilot = self.autopilots[index]
        if self.disturbances.ignores_setpoints[index] and autopilot.setpoint is not None:
            setpoint = replace(autopilot.setpoint, time_s=setpoint.time_s)
        autopilot.accept_setpoint(setpoint)

    def follows_setpoints(self, index: int) -> bool:
        """Return whether an autopilot is in OFFBOARD and follows new setpoints."""
        autopilot = self.autopilots[index]
        if autopilot.mode is not Mode.OFFBOARD or autopilot.setpoint is None:
            return False
        if self.disturbances.is_hung[index] or self.disturbances.ignores_setpoints[index]:
            return False
        return self.clock_s(index) - autopilot.setpoint.time_s <= _NEW_SETPOINT_S

    def corrections(self, index: int, flags: int, data: bytes) -> None:
        """Deliver a GPS_RTCM_DATA to the receiver of a vehicle."""
        if self.disturbances.is_hung[index]:
            return
        self._has_corrections = True
        self.receivers[index].hear(flags, data, self.time_s)

    def fix_type(self, index: int) -> int:
        """Return GPS_RAW_INT.fix_type of a vehicle."""
        has_fix = self.estimator.sees_satellites(index, self.time_s)
        return self.receivers[index].fix_type(self.time_s, has_fix=has_fix)

    def _follow_fixes(self) -> None:
        """Set the estimate errors by fix type, and shift the estimates with their base stations."""
        estimator = self.estimator
        for index, receiver in enumerate(self.receivers):
            fix_type = self.fix_type(index)
            sensors = estimator.sensors[index]
            sensors.gps_level = GPS_LEVELS.get(fix_type, GPS)
            sensors.gps_accuracy_m = GPS_ACCURACIES_M.get(fix_type, GPS_ACCURACY_M)

            # The direction of the shift does not matter here, so every shift is to the north.
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
        """Use an external position (ODOMETRY, VISION_POSITION_ESTIMATE) if a parameter enables it.

        Args:
            index: index of the vehicle.
            position_ned_m: external position (3,).
            yaw_rad: heading of the same message; NaN: the true heading is used.
            has_velocity: whether the message has a velocity.
            reset_count: reset counter of the message; a change of it restarts the estimate at this
                position.
        """
        is_used = bool(self.autopilots[index].params.integer("EKF2_EV_CTRL") & _USES_POSITION)
        if not is_used or self.disturbances.is_hung[index]:
            return

        if math.isnan(yaw_rad):
            yaw_rad = float(self.world.vehicles.states.yaw_rad[index])
        self._set_vision_level(index, has_velocity=has_velocity)

        self._vision_poses[index, :3] = position_ned_m
        self._vision_poses[index, 3] = yaw_rad

        faults = self.disturbances.vision
        if faults.is_clear:
            self._fuse(index, self._vision_poses[index], reset_count)
            return
        if faults.is_lost(index):
            return

        pose = faults.apply(self._vision_poses, self.time_s, index)[index]
        delay_s = faults.delay_s(index)
        if delay_s > 0.0:
            arrival_s = self.time_s + delay_s
            self._late_vision.append(LateVision(arrival_s, index, pose, reset_count))
        else:
            self._fuse(index, pose, reset_count)

    def _send_odometry(self) -> None:
        """Send each PX4 with a camera the next pose of its visual odometry."""
        states = self.world.vehicles.states
        rows = self._with_cameras
        poses = self._odometry.poses(
            states.position_ned_m[rows], states.yaw_rad[rows], states.on_ground[rows]
        )
        for index, pose in zip(rows, poses, strict=True):
            self.vision(index, pose[:3], yaw_rad=float(pose[3]))

    def _fuse(self, index: int, pose: Array, reset_count: int) -> None:
        """Fuse an external position and heading (4,) that arrives with this reset counter."""
        if reset_count != self._vision_resets[index]:
            self._vision_resets[index] = reset_count
            self.estimator.begin_vision_anew(index)

        delay_s = self.autopilots[index].params["EKF2_EV_DELAY"] / 1000.0
        yaw_error_rad = float(pose[3]) - float(self.world.vehicles.states.yaw_rad[index])
        self.estimator.fuse_vision(
            index, self.time_s, pose[:3], delay_s=delay_s, yaw_error_rad=yaw_error_rad
        )

    def _fuse_late_vision(self) -> None:
        late = self._late_vision
        now_s = self.time_s + _TIME_TOLERANCE_S
        self._late_vision = [entry for entry in late if entry.arrival_s > now_s]
        for entry in late:
            has_arrived = entry.arrival_s <= now_s
            if has_arrived and not self.disturbances.is_hung[entry.vehicle_index]:
                self._fuse(entry.vehicle_index, entry.pose, entry.reset_count)

    def _set_vision_level(self, index: int, *, has_velocity: bool) -> None:
        params = self.autopilots[index].params
        uses_velocity = bool(params.integer("EKF2_EV_CTRL") & _USES_VELOCITY)
        self.estimator.sensors[index].vision_level = vision_level(
            params["EKF2_EVP_NOISE"],
            params["EKF2_TAU_VEL"],
            has_velocity=has_velocity and uses_velocity,
        )

    def reset_parameters(self, index: int) -> None:
        """Reset an autopilot's parameters to PX4's defaults and those of the simulation."""
        params = self.autopilots[index].params
        params.values.update(params.defaults)
        params.values.update(_simulation_parameters(self.specs[index], self.origin))
        self.parameters_changed(index)

    def parameters_changed(self, index: int) -> None:
        """Copy the values of an autopilot's parameters to the parts that use them."""
        params = self.autopilots[index].params
        uses_satellites = bool(params.integer("EKF2_GPS_CTRL") & _USES_POSITION)
        has_receiver = params.integer("SYS_HAS_GPS") != 0
        uses_vision_yaw = bool(params.integer("EKF2_EV_CTRL") & _USES_YAW)

        sensors = self.estimator.sensors[index]
        sensors.has_gps = uses_satellites and has_receiver
        sensors.uses_vision_yaw = uses_vision_yaw
        sensors.vision_noise_m = params["EKF2_EVP_NOISE"]
        heading_noise_rad = params["EKF2_EVA_NOISE"]
        sensors.heading_gain = _HEADING_GAIN
        if self.autopilots[index].version.takes_heading_noise_as_variance:
            heading_noise_rad = math.sqrt(max(heading_noise_rad, 0.0))
            sensors.heading_gain = _HEADING_GAIN_OF_VARIANCE
        heading_noise_rad = max(heading_noise_rad, _LEAST_HEADING_NOISE_RAD)
        sensors.heading_gate_rad = _HEADING_GATE_SIGMAS * heading_noise_rad
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

        The autopilot commands an attitude relative to its estimate of heading and level. The
        vehicle needs the attitude relative to the true ones.
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
    """Run each loop once, so that it is compiled before time runs.

    Compiling takes seconds at the first start on a machine.
    """
    profile = VehicleProfile()
    world = World([profile, profile], np.array([[0.0, 0.0, 5.0], [3.0, 0.0, 5.0]]))
    world.step()
    states = world.vehicles.states
    estimator = Estimator(states.position_ned_m, seed=0)
    estimator.step(0.0, states.position_ned_m, states.velocity_ned_m_s, states.on_ground)
