"""A simple position hold by attitude setpoints, and the start and end of the groups' flights."""

from __future__ import annotations

import math
from typing import Any

from sitl.conformance.vehicle_client import (
    ARM,
    FORCE,
    LAND,
    Quaternion,
    Stuck,
    VehicleClient,
    quaternion,
)

_GRAVITY = 9.81
_PERIOD_S = 0.02
_CLIMB_LIMIT_M_S = 2.5
_SINK_LIMIT_M_S = 1.5
_SPEED_LIMIT_M_S = 1.5  # horizontal
_ACCEL_LIMIT_M_S2 = 3.0  # horizontal
_POSITION_GAIN_1_S = 0.7
_VELOCITY_GAIN_1_S = 1.5
_HEIGHT_GAIN_1_S = 3.0  # acceleration per error of the vertical speed
_DRAG_1_S = 1.0

# The hover thrust of an unknown vehicle is estimated below this vertical speed, within limits.
_ESTIMATE_BELOW_M_S = 0.4
_ESTIMATE_GAIN_1_M = 0.04  # change of the thrust per second, for each m/s of error
_SIH_HOVER_THRUST = 0.49
_MIN_HOVER_THRUST = 0.2
_MAX_HOVER_THRUST = 0.8
_MIN_THRUST = 0.12

# A vehicle within these limits has come to rest in the air.
_CALM_HEIGHT_M = 0.3
_CALM_CLIMB_M_S = 0.35
_CALM_SPEED_M_S = 0.6
_CALM_TILT_RAD = 0.1

_RATES_HZ = {
    "LOCAL_POSITION_NED": 100.0,
    "ATTITUDE": 250.0,
    "ATTITUDE_TARGET": 250.0,
    "EXTENDED_SYS_STATE": 20.0,
}


class Hover:
    """Position and height hold that can be called as a setpoint stream.

    Attributes:
        goal: north, east, down in the local frame of the vehicle [m].
        yaw_rad: heading that is held.
        thrust: estimate of the thrust that balances the weight; initially the hover thrust of the
            SIH quadrotor.
        tilt: roll and pitch that replace the horizontal hold [rad]; None: the position is held.
        is_resting: whether level attitudes without thrust are sent, for a vehicle on the ground.
    """

    def __init__(self, client: VehicleClient) -> None:
        self._client = client
        position = client.newest("LOCAL_POSITION_NED")
        self.ground_z = float(position.z)
        self.goal = [float(position.x), float(position.y), float(position.z)]
        self.yaw_rad = client.euler().yaw
        self.tilt: tuple[float, float] | None = None
        self.thrust = _SIH_HOVER_THRUST
        self.is_resting = True

    @property
    def height_m(self) -> float:
        """Height above the ground at the start."""
        return self.ground_z - float(self._client.newest("LOCAL_POSITION_NED").z)

    def to_height(self, height_m: float) -> None:
        """Fly to a height above the ground."""
        self.goal[2] = self.ground_z - height_m
        self.is_resting = False

    def hold_here(self) -> None:
        """Hold the present position."""
        position = self._client.newest("LOCAL_POSITION_NED")
        self.goal[:2] = [float(position.x), float(position.y)]
        self.tilt = None

    def __call__(self) -> None:
        """Send the present attitude and thrust."""
        q, thrust = self.output()
        self._client.attitude(q, thrust)

    def output(self) -> tuple[Quaternion, float]:
        """Return the present attitude and thrust."""
        if self.is_resting:
            return quaternion(0.0, 0.0, self.yaw_rad), 0.0

        position = self._client.newest("LOCAL_POSITION_NED")
        if self.tilt is None:
            roll, pitch = self._tilt_to_goal(position)
        else:
            roll, pitch = self.tilt

        # The error in height determines a vertical speed, the error in speed a lift.
        down_m_s = _clip(self.goal[2] - position.z, _CLIMB_LIMIT_M_S, _SINK_LIMIT_M_S)
        excess_m_s = position.vz - down_m_s  # sinking speed above the setpoint
        lift_m_s2 = _GRAVITY + _HEIGHT_GAIN_1_S * excess_m_s
        if abs(position.vz) < _ESTIMATE_BELOW_M_S:
            estimate = self.thrust + _ESTIMATE_GAIN_1_M * _PERIOD_S * excess_m_s
            self.thrust = min(_MAX_HOVER_THRUST, max(_MIN_HOVER_THRUST, estimate))

        # A tilted vehicle lifts with the cosine of its tilt.
        thrust = self.thrust * lift_m_s2 / _GRAVITY / (math.cos(roll) * math.cos(pitch))
        return quaternion(roll, pitch, self.yaw_rad), min(1.0, max(_MIN_THRUST, thrust))

    def _tilt_to_goal(self, position: Any) -> tuple[float, float]:
        """Return roll and pitch that lead to the goal, from a LOCAL_POSITION_NED."""
        goal_north, goal_east, _ = self.goal
        north = self._acceleration(goal_north - position.x, position.vx)
        east = self._acceleration(goal_east - position.y, position.vy)

        # Roll and pitch are relative to the present heading, and not to the heading that is held.
        yaw = self._client.euler().yaw
        forward = math.cos(yaw) * north + math.sin(yaw) * east
        right = -math.sin(yaw) * north + math.cos(yaw) * east

        return math.atan(right / _GRAVITY), -math.atan(forward / _GRAVITY)

    @staticmethod
    def _acceleration(error_m: float, speed_m_s: float) -> float:
        setpoint_m_s = _clip(_POSITION_GAIN_1_S * error_m, _SPEED_LIMIT_M_S, _SPEED_LIMIT_M_S)
        drag_m_s2 = _DRAG_1_S * speed_m_s
        acceleration_m_s2 = _VELOCITY_GAIN_1_S * (setpoint_m_s - speed_m_s) + drag_m_s2
        return _clip(acceleration_m_s2, _ACCEL_LIMIT_M_S2, _ACCEL_LIMIT_M_S2)


def _clip(value: float, below: float, above: float) -> float:
    """Return a value between -below and above."""
    return max(-below, min(above, value))


def airborne(client: VehicleClient, height_m: float) -> Hover:
    """Fly to a height in OFFBOARD by attitude setpoints, and return the hold.

    The vehicle is then at rest in the air. The flight begins on the ground or in the air.

    Raises:
        Stuck: the vehicle cannot be armed or does not come to rest at the height.
    """
    hover = client.setpoint_duty.act
    is_flying = client.is_armed and client.mode == "OFFBOARD"
    if not isinstance(hover, Hover) or not is_flying:
        hover = _arm_in_offboard(client)

    hover.tilt = None
    hover.to_height(height_m)
    settle(client, hover)
    return hover


def _arm_in_offboard(client: VehicleClient) -> Hover:
    """Bring the vehicle to the ground and arm it in OFFBOARD; return its hold, without thrust.

    Raises:
        Stuck: the vehicle cannot be armed.
    """
    grounded(client)
    fast_streams(client)
    hover = Hover(client)
    client.stream(hover)
    client.wait(0.3)

    client.set_mode("OFFBOARD")
    answer = client.command(ARM, 1.0)
    if not answer.startswith("ACCEPTED"):
        raise Stuck(f"arming was answered with {answer}")
    return hover


def settle(client: VehicleClient, hover: Hover, timeout_s: float = 14.0) -> None:
    """Wait until the vehicle rests at the height of the goal.

    Raises:
        Stuck: the vehicle does not rest within the time.
    """

    def is_calm() -> bool:
        position = client.newest("LOCAL_POSITION_NED")
        height_error_m = abs(position.z - hover.goal[2])
        speed_m_s = math.hypot(position.vx, position.vy)
        roll, pitch, _ = client.euler()
        return (
            height_error_m < _CALM_HEIGHT_M
            and abs(position.vz) < _CALM_CLIMB_M_S
            and speed_m_s < _CALM_SPEED_M_S
            and math.hypot(roll, pitch) < _CALM_TILT_RAD
        )

    if not client.wait(timeout_s, is_calm):
        raise Stuck("it did not come to rest in the air")


def fast_streams(client: VehicleClient) -> None:
    """Request the rates that the hold and the measurements need."""
    for name, hz in _RATES_HZ.items():
        client.interval(name, hz)


def default_streams(client: VehicleClient) -> None:
    """Request the default rates."""
    for name in _RATES_HZ:
        client.interval(name, 0.0)


def grounded(client: VehicleClient) -> None:
    """Bring the vehicle to the state in which all groups on the ground start.

    The vehicle then is on the ground, disarmed, in AUTO.LOITER, and receives no setpoints.

    Raises:
        Stuck: the vehicle cannot be disarmed.
    """
    if client.is_armed:
        _disarm(client)
    client.stream(None)

    if client.mode != "AUTO.LOITER":
        client.set_mode("AUTO.LOITER")
        client.next_heartbeat(2)
    if client.is_armed:
        raise Stuck("it could not be disarmed")


def _disarm(client: VehicleClient) -> None:
    """Land if the vehicle flies, and disarm it, by force if it does not disarm in time."""
    if client.landed != "ON_GROUND":
        client.command(LAND)
    else:
        client.stream(None)
        client.command(ARM, 0.0)

    # In the air setpoints continue until PX4 has left OFFBOARD for the landing.
    client.wait(2.0, lambda: client.mode != "OFFBOARD")
    client.stream(None)

    if not client.wait(40.0, lambda: not client.is_armed):
        client.command(ARM, 0.0, FORCE)
        client.next_heartbeat()
