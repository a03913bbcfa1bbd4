"""PX4 parameters that the fleet requires, with their reasons, and how a vehicle differs from them.

The parameters of PX4's own failsafes come from ``own_failsafes.toml``. The preflight check refuses
a take-off with wrong values, and ``covey px4 params`` lists and sets the parameters.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from onboard.autopilot import Version, plausible_version
from onboard.config.fleet import HEADING_NOISE_RAD, FleetConfig, Vehicle
from onboard.px4.own_failsafes import FIRST, LAST, OwnParameter, demanded_parameters
from onboard.safety.geofence import fence_of

Value = float | int

# Bits of EKF2_EV_CTRL.
FUSES_POSITION = 1
FUSES_HEADING = 8
_FUSES_PLACE = 3  # position and height

# charge at which PX4's simulated battery stops emptying [%]; it is read, but no value is required
BATTERY_FLOOR = "SIM_BAT_MIN_PCT"

_SILENCE = "COM_OF_LOSS_T"
# the agent's landing level is above PX4's critical level by at least this
_BATTERY_GAP_FRAC = 0.005
# PX4's tilt limit is above max_tilt_deg by at least this. After a commanded step, the tilt
# overshoots by a tenth. The rest is for gusts.
_TILT_MARGIN_DEG = 15


@dataclass(frozen=True, slots=True)
class RequiredParam:
    """One required parameter."""

    name: str  # PX4's name of the parameter
    value: Value  # required value
    reason: str  # effect of the value
    needs_restart: bool = False  # whether PX4 reads it only at its start
    # whether another value affects only quality, not safety; it then does not refuse a take-off,
    # and only `covey px4 params --apply` sets it
    is_advice: bool = False

    # other acceptable values
    tolerance: float = 0.0  # every value that differs from the required value by at most this
    accepts: tuple[Value, ...] = ()  # each of these values
    least: Value | None = None  # every value between least and most
    most: Value | None = None
    without_bits: int = 0  # every value that has none of these bits

    is_optional: bool = False  # whether a PX4 may lack this parameter
    since: Version = FIRST  # first version of PX4 that has it
    before: Version = LAST  # first version of PX4 that no longer has it

    def is_for(self, version: Version | None) -> bool:
        """Whether a PX4 of this version has it. For an unknown version, whether every PX4 has
        it.
        """
        if version is None:
            return self.since == FIRST and self.before == LAST
        return self.since <= version < self.before

    def is_met(self, value: Value | None) -> bool:
        """Whether PX4's value is the required one or another acceptable one; False for None."""
        if value is None:
            return False
        if any(_is_close(value, good, self.tolerance) for good in (self.value, *self.accepts)):
            return True
        if self.without_bits:
            return int(value) & self.without_bits == 0
        return self._is_between(value)

    def _is_between(self, value: Value) -> bool:
        if self.least is None and self.most is None:
            return False
        least = -math.inf
        if self.least is not None:
            least = self.least
        most = math.inf
        if self.most is not None:
            most = self.most
        return least <= value <= most

    @property
    def words(self) -> str:
        """The required value and the other acceptable values, in words."""
        others = [f"{value:g}" for value in self.accepts]
        if self.without_bits:
            others.append(f"any without bit {self.without_bits}")
        if self.least is not None:
            others.append(f"{self.least:g} or more")
        if self.most is not None:
            others.append(f"{self.most:g} or less")
        if not others:
            return f"{self.value:g}"
        return f"{self.value:g} (or {', '.join(others)})"


def _is_close(value: Value, good: Value, tolerance: float) -> bool:
    return math.isclose(float(value), float(good), rel_tol=1e-5, abs_tol=max(1e-6, tolerance))


def _required(parameter: OwnParameter) -> RequiredParam:
    """Return the requirement for a parameter of one of PX4's own failsafes."""
    assert parameter.demand is not None
    return RequiredParam(
        name=parameter.name,
        value=parameter.demand,
        reason=parameter.reason,
        accepts=parameter.accepts,
        least=parameter.least,
        most=parameter.most,
        without_bits=parameter.without_bits,
        is_optional=parameter.is_optional,
        since=parameter.since,
        before=parameter.before,
    )


_OWN = {parameter.name: parameter for parameter in demanded_parameters()}
FAILSAFES = tuple(_required(parameter) for parameter in _OWN.values())

_MOCAP = (
    RequiredParam(
        "EKF2_EV_CTRL",
        15,
        "PX4 fuses position, height, velocity and heading of the mocap (bits 1 2 4 8)",
    ),
    RequiredParam("EKF2_HGT_REF", 3, "PX4's height comes from the mocap (3)", needs_restart=True),
    RequiredParam("EKF2_GPS_CTRL", 0, "PX4 does not use satellites (0), which are wrong indoors"),
    RequiredParam(
        "EKF2_MAG_TYPE",
        5,
        "PX4's heading comes from the mocap, not from a compass near motors and steel (5: no "
        "compass)",
        needs_restart=True,
    ),
)

_MOCAP_ADVICE = (
    RequiredParam(
        "EKF2_EVP_NOISE",
        0.01,
        "a mocap is accurate to a centimetre [m]: PX4's own hold and land stay in position",
        is_advice=True,
    ),
    RequiredParam(
        "EKF2_TAU_VEL", 0.02, "PX4's output follows its filter at once [s]", is_advice=True
    ),
    RequiredParam(
        "EKF2_TAU_POS", 0.1, "PX4's output follows its filter at once [s]", is_advice=True
    ),
    # PX4 raises it to the largest delay of any sensor, used or not: 110 ms for satellites in v1.16,
    # 100 ms for airspeed
    RequiredParam(
        "EKF2_DELAY_MAX",
        100.0,
        "PX4's filter lags no further than it must [ms]",
        needs_restart=True,
        is_advice=True,
        tolerance=80.0,
    ),
)

# for a vehicle whose PX4 gets its position from a camera
_CAMERA = (
    RequiredParam(
        "EKF2_EV_CTRL",
        11,
        "PX4 fuses position, height and heading of the odometry (bits 1 2 8; 4: its velocity too)",
        accepts=(15,),
    ),
    RequiredParam(
        "EKF2_EVA_NOISE",
        HEADING_NOISE_RAD,
        "what PX4 says of the odometry's heading shows a camera that has begun anew, turned [rad]",
    ),
    RequiredParam(
        "EKF2_GPS_CTRL",
        0,
        "PX4's position comes from the odometry alone (without bit 1: no position of satellites)",
        without_bits=1,
    ),
    RequiredParam(
        "EKF2_HGT_REF",
        3,
        "PX4's height follows the odometry (3), not a barometer or satellites",
        needs_restart=True,
        is_advice=True,
    ),
    RequiredParam(
        "EKF2_EVP_NOISE",
        0.01,
        "distances count on a position that errs by 5 cm [m]; PX4 takes odometry for no more "
        "accurate than this",
        is_advice=True,
        most=0.03,
    ),
    *(param for param in _MOCAP_ADVICE if param.name in ("EKF2_TAU_VEL", "EKF2_TAU_POS")),
)

# and for one whose camera gives PX4 its heading
_CAMERA_HEADING = RequiredParam(
    "EKF2_MAG_TYPE",
    5,
    "PX4's heading comes from the odometry, not from a compass near motors and steel (5: no "
    "compass)",
    needs_restart=True,
    is_advice=True,
)

# all for a vehicle with a mocap, and what replaces the values about it for one with a camera;
# docs/deployment.md lists both
BUILT_IN = (*FAILSAFES, *_MOCAP, *_MOCAP_ADVICE)
WITH_CAMERA = (*_CAMERA, _CAMERA_HEADING)


def all_params(
    fleet: FleetConfig, vehicle: Vehicle, version: Version | None = None
) -> tuple[RequiredParam, ...]:
    """Return all values that this vehicle's PX4 should have.

    The fleet file's ``px4_params`` replace built-in values. But they must not weaken a value that
    keeps one of PX4's own failsafes from interfering (:func:`weakened`).

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
        version: version that its PX4 has reported; None if it is not known.
    """
    version = plausible_version(version)
    hover_throttle = RequiredParam(
        "MPC_THR_HOVER",
        min(max(vehicle.hover_thrust_frac, 0.1), 0.8),  # PX4's own bounds
        "PX4's own hold and land begin with this throttle",
        is_advice=True,
        tolerance=0.1,
    )
    failsafes = [_bounded(param, fleet, vehicle) for param in FAILSAFES]
    built_in = [*failsafes, hover_throttle]
    if vehicle.mocap_required:
        built_in = [*failsafes, *_MOCAP, *_MOCAP_ADVICE, hover_throttle]
    elif vehicle.flies_by_vision:
        built_in = [*failsafes, *_for_camera(vehicle), hover_throttle]

    of_file = dict(vehicle.px4_params)
    for param in _weakened_params(fleet, vehicle):
        of_file.pop(param.name)

    params = [param for param in built_in if param.name not in of_file and param.is_for(version)]
    for name, value in of_file.items():
        params.append(RequiredParam(name, value, "the fleet file's px4_params require it"))
    return tuple(params)


def _for_camera(vehicle: Vehicle) -> tuple[RequiredParam, ...]:
    """Return the values for a vehicle by vision.

    If its fleet file has PX4 fuse no heading of the odometry, PX4 needs its compass.
    """
    if vehicle.has_heading_by_vision:
        return WITH_CAMERA
    return _CAMERA


def _bounded(param: RequiredParam, fleet: FleetConfig, vehicle: Vehicle) -> RequiredParam:
    """Return a parameter with this vehicle's bound from the fleet file.

    ``OwnParameter.bound`` names the limit of the fleet file.
    """
    bound = _OWN[param.name].bound
    if bound == "below battery_land_pct":
        most_frac = 0.01 * fleet.fleet.battery_land_pct - _BATTERY_GAP_FRAC
        return replace(param, most=round(max(most_frac, float(param.value)), 4))
    if bound == "beyond max_tilt_deg":
        return replace(param, least=math.ceil(vehicle.max_tilt_deg) + _TILT_MARGIN_DEG)
    if not bound:
        return param

    fence = fence_of(fleet.fleet.geofence_m, vehicle)
    across_m, upwards_m = fence.farthest_m(vehicle.max_speed_m_s)
    distances_m = {"beyond geofence_m": across_m, "above geofence_m": upwards_m}
    least_m = float(math.ceil(distances_m[bound]))
    return replace(param, value=least_m, accepts=(param.value,), least=least_m)


def _may_replace(param: RequiredParam, value: Value) -> bool:
    """Return whether a fleet file may require this value instead of the built-in value."""
    own = _OWN[param.name]
    if own.file_least is None or own.file_most is None:
        return param.is_met(value)
    return own.file_least <= value <= own.file_most


def _weakened_params(fleet: FleetConfig, vehicle: Vehicle) -> list[RequiredParam]:
    """Return the built-in parameters that the fleet file's ``px4_params`` weaken."""
    weak = []
    for param in FAILSAFES:
        value = vehicle.px4_params.get(param.name)
        bounded = _bounded(param, fleet, vehicle)
        if value is not None and not _may_replace(bounded, value):
            weak.append(bounded)

    if vehicle.flies_by_vision:
        for param in _CAMERA:
            value = vehicle.px4_params.get(param.name)
            if value is not None and not _flies_by_camera(param, value):
                weak.append(param)
    return weak


def _flies_by_camera(param: RequiredParam, value: Value) -> bool:
    """Return whether PX4 takes its position from the odometry with this value of the fleet file."""
    if param.is_advice:
        return True
    if param.name == "EKF2_EV_CTRL":
        return int(value) & _FUSES_PLACE == _FUSES_PLACE
    return param.is_met(value)


def weakened(fleet: FleetConfig, vehicle: Vehicle) -> tuple[str, ...]:
    """Return a sentence for each of the fleet file's ``px4_params`` that weakens a requirement.

    Args:
        fleet: the fleet file.
        vehicle: one of its vehicles.
    """
    sentences = []
    for param in _weakened_params(fleet, vehicle):
        value = vehicle.px4_params[param.name]
        sentences.append(
            f"The fleet file's px4_params set {param.name} = {value:g} for {vehicle.name}, which"
            f" every flight needs at {param.words}: {param.reason}."
        )
    return tuple(sentences)


def required_params(
    fleet: FleetConfig, vehicle: Vehicle, version: Version | None = None
) -> dict[str, RequiredParam]:
    """Return by name the parameters that are required for take-off.

    These are the built-in parameters and those of the fleet file.
    """
    params = all_params(fleet, vehicle, version)
    return {param.name: param for param in params if not param.is_advice}


def silence_s(vehicle: Vehicle) -> float:
    """Return how long [s] PX4 follows the last setpoint before it lands."""
    demand = _OWN[_SILENCE].demand
    assert demand is not None
    return float(vehicle.px4_params.get(_SILENCE, demand))


def unmet(
    required: Iterable[RequiredParam], actual: Mapping[str, Value | None]
) -> list[RequiredParam]:
    """Return the parameters with a wrong value in PX4. Those that PX4 did not send are left out.

    Args:
        required: required parameters.
        actual: name -> PX4's value; None if PX4 did not send it.
    """
    wrong = []
    for param in required:
        value = actual.get(param.name)
        if value is not None and not param.is_met(value):
            wrong.append(param)
    return wrong


def differences(
    required: Iterable[RequiredParam], actual: Mapping[str, Value | None]
) -> tuple[str, ...]:
    """Return a sentence for each parameter that is not as required.

    Args:
        required: required parameters.
        actual: name -> PX4's value; None if PX4 did not send it.
    """
    sentences: list[str] = []
    for param in required:
        value = actual.get(param.name)
        if value is None and not param.is_optional:
            sentences.append(
                f"PX4 did not send its parameter {param.name}: check the link and PX4's version."
            )
        elif value is not None and not param.is_met(value):
            sentences.append(
                f"PX4 parameter {param.name} is {value:g}, this fleet requires {param.words}."
            )
    return tuple(sentences)
