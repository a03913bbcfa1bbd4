"""Vehicles, estimates and autopilots in one world, advanced step by step. No sockets, no clock: time is counted.

Truth flows one way: world -> estimator -> autopilot -> world. What is published as ground truth is a copy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl import rotation
from sitl.autopilot import TICK_S, Autopilot
from sitl.position_control import Goal
from sitl.rotation import Array
from sitl.sensors import ESTIMATE_EVERY_STEPS, Estimator, Source, vision_level
from sitl.signals import Actuation, Setpoint, SetpointKind, Situation
from sitl.vehicle import STEP_S, VehicleProfile
from sitl.world import Collision, World

_GPS_FIX_S = 2.3
_TICK_STEPS = round(TICK_S / STEP_S)
_NAN_DRIFT_RAD_S = -0.12  # PX4 takes an attitude of NaN and rolls away slowly
_IGNORE_BODY_RATES = 7
_IGNORE_THRUST = 64
_IGNORE_ATTITUDE = 128


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """One vehicle to emulate."""

    name: str
    system_id: int
    profile: VehicleProfile
    start_enu_m: tuple[float, float, float]


class Emulator:
    """Several PX4s and their vehicles.

    Args:
        specs: the vehicles, in order.
        body_diameter_m: see :class:`World`.
        seed: of everything random.
    """

    def __init__(self, specs: list[VehicleSpec], *, body_diameter_m: float = 0.5, seed: int = 0) -> None:
        self.specs = list(specs)
        start_enu_m = np.array([spec.start_enu_m for spec in specs], dtype=np.float64).reshape(-1, 3)
        self.world = World(
            [s.profile for s in specs],
            start_enu_m,
            body_diameter_m=body_diameter_m,
            seed=seed,
            names=[s.name for s in specs],
        )
        self.estimator = Estimator(self.world.vehicles.states.position_ned_m, seed=seed)
        self.autopilots = [Autopilot() for _ in specs]
        for autopilot, spec in zip(self.autopilots, specs, strict=True):
            autopilot.params.values["MAV_SYS_ID"] = spec.system_id
        self.has_global_origin = [False] * len(specs)
        self._applied: list[Actuation | None] = [None] * len(specs)
        self._estimate()

    @property
    def time_s(self) -> float:
        """Simulated time since the start [s]."""
        return self.world.time_s

    def step(self) -> list[Collision]:
        """Advance everything by 4 ms."""
        steps = self.world.vehicles.steps
        if steps % _TICK_STEPS == 0:
            for index, autopilot in enumerate(self.autopilots):
                autopilot.tick(self.situation(index))
        for index, autopilot in enumerate(self.autopilots):
            if autopilot.actuation is not self._applied[index]:
                self._apply(index, autopilot.actuation)
        collisions = self.world.step()
        if self.world.vehicles.steps % ESTIMATE_EVERY_STEPS == 0:
            self._estimate()
        return collisions

    def situation(self, index: int) -> Situation:
        """What one autopilot knows of its vehicle."""
        local = self.estimator.local(index)
        source = self.estimator.source[index]
        states = self.world.vehicles.states
        return Situation(
            time_s=self.time_s,
            position_ned_m=np.array(local.position_ned_m),
            velocity_ned_m_s=np.array(local.velocity_ned_m_s),
            attitude=self.believed_attitude(index),
            yaw_rad=self.believed_yaw_rad(index),
            on_ground=bool(states.on_ground[index]),
            has_global_position=self._has_global_position(index, source),
            has_local_position=source is not Source.NONE,
        )

    def _has_global_position(self, index: int, source: Source) -> bool:
        # Satellites give it by themselves; a local position becomes one when somebody has said where its origin is.
        by_satellites = self.estimator.has_gps[index] and self.time_s > _GPS_FIX_S
        return by_satellites or (source is Source.VISION and self.has_global_origin[index])

    def believed_yaw_rad(self, index: int) -> float:
        """Heading with the compass's error [rad]."""
        yaw = self.world.vehicles.states.yaw_rad[index] + self.estimator.yaw_error_rad[index]
        return float(rotation.wrap(yaw))

    def believed_attitude(self, index: int) -> Array:
        """Attitude NED <- FRD (4,) with the compass's error, without noise."""
        states = self.world.vehicles.states
        return rotation.from_yaw_and_tilt(
            states.yaw_rad[index] + self.estimator.yaw_error_rad[index], states.tilt_rad[index]
        )

    def attitude_setpoint(
        self, index: int, attitude_wxyz: list[float], rate_rad_s: list[float], thrust_frac: float, type_mask: int
    ) -> None:
        """SET_ATTITUDE_TARGET as PX4 takes it: nothing is refused, the nonsensical becomes something tame or not."""
        now = self.time_s
        thrust = 0.0 if type_mask & _IGNORE_THRUST or not math.isfinite(thrust_frac) else thrust_frac
        thrust = min(1.0, max(0.0, thrust))
        if type_mask & _IGNORE_ATTITUDE:
            rate = np.nan_to_num(np.array(rate_rad_s, dtype=np.float64), nan=0.0, posinf=0.0, neginf=0.0)
            setpoint = Setpoint(SetpointKind.RATE, now, None, np.clip(rate, -4.0, 4.0), thrust)
        elif not all(map(math.isfinite, attitude_wxyz)):
            drift = np.array([_NAN_DRIFT_RAD_S, 0.0, 0.0])
            setpoint = Setpoint(SetpointKind.RATE, now, None, drift, thrust)
        else:
            attitude = np.array(attitude_wxyz, dtype=np.float64)
            norm = float(np.linalg.norm(attitude))
            level = rotation.yaw_quaternion(np.asarray(self.believed_yaw_rad(index)))
            setpoint = Setpoint(SetpointKind.ATTITUDE, now, attitude / norm if norm > 1e-6 else level, None, thrust)
        self.autopilots[index].accept_setpoint(setpoint)

    def position_setpoint(self, index: int, fields: dict[str, float], *, is_body_frame: bool) -> None:
        """SET_POSITION_TARGET_LOCAL_NED by MAVLink's field names; ignored axes become NaN."""
        mask = int(fields["type_mask"])
        position = np.array([fields[k] if not mask & bit else math.nan for k, bit in (("x", 1), ("y", 2), ("z", 4))])
        velocity = np.array([fields[k] if not mask & bit else 0.0 for k, bit in (("vx", 8), ("vy", 16), ("vz", 32))])
        velocity = np.where(np.isfinite(velocity), velocity, 0.0)
        yaw = self.believed_yaw_rad(index)
        if is_body_frame:
            c, s = math.cos(yaw), math.sin(yaw)
            velocity = np.array([c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1], velocity[2]])
        goal_yaw = yaw if mask & 1024 or not math.isfinite(fields["yaw"]) else fields["yaw"]
        if mask & 1024 and not mask & 2048 and math.isfinite(fields["yaw_rate"]):
            goal_yaw = yaw + 0.5 * fields["yaw_rate"]
        goal = Goal(position, velocity, goal_yaw)
        self.autopilots[index].accept_setpoint(Setpoint(SetpointKind.POSITION, self.time_s, goal=goal))

    def vision(self, index: int, position_ned_m: Array) -> None:
        """One external position (ODOMETRY, VISION_POSITION_ESTIMATE), fused if the parameters say so."""
        params = self.autopilots[index].params
        if int(params["EKF2_EV_CTRL"]) & 1:
            delay_s = params["EKF2_EV_DELAY"] / 1000.0
            self.estimator.fuse_vision(index, self.time_s, position_ned_m, delay_s=delay_s)

    def parameters_changed(self, index: int) -> None:
        """Carry parameters over to where they act."""
        params = self.autopilots[index].params
        self.estimator.has_gps[index] = int(params["EKF2_GPS_CTRL"]) & 1 == 1 and int(params["SYS_HAS_GPS"]) != 0
        self.estimator.uses_vision_yaw[index] = bool(int(params["EKF2_EV_CTRL"]) & 8)
        self.estimator.vision_levels[index] = vision_level(params["EKF2_EVP_NOISE"], params["EKF2_TAU_VEL"])

    def _estimate(self) -> None:
        states = self.world.vehicles.states
        self.estimator.step(self.time_s, states.position_ned_m, states.velocity_ned_m_s, states.on_ground)

    def _apply(self, index: int, actuation: Actuation) -> None:
        commands = self.world.commands
        # The autopilot steers in the heading it believes in; the vehicle turns in the one it has.
        undo = rotation.yaw_quaternion(np.asarray(-self.estimator.yaw_error_rad[index]))
        commands.attitude[index] = rotation.multiply(undo, actuation.attitude)
        commands.rate_rad_s[index] = actuation.rate_rad_s
        commands.is_rate[index] = actuation.is_rate
        commands.thrust_frac[index] = actuation.thrust_frac
        commands.motors_on[index] = actuation.motors_on
        self._applied[index] = actuation
