"""Reads the input of the identification from a record: commands and motion of each vehicle."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from groundstation.identification.logged_stretch import Log
from groundstation.recording.reader import Sample
from groundstation.recording.timeline import Timeline
from onboard.arrays import Array
from onboard.config.fleet import FleetConfig

_LOW_M = 0.3  # below this height above its spot, the ground may bear a part of the weight
_LARGEST = 1e6  # largest believable number: metres, parts of a quaternion, thrust
_GAP_S = 0.1  # a longer gap between ticks ends a stretch
# age of an attitude that PX4 sends at 50-100 Hz over a link: half a period, and the transmission
_LINK_AGE_S = 0.012
_LINK_AGE_STD_S = 0.008
_QUATERNIONS = ("setpoint_quaternion_enu_flu_wxyz", "attitude_quaternion_enu_flu_wxyz")


def logs_of(path: Path, fleet: FleetConfig, names: Sequence[str]) -> dict[str, Log]:
    """Read the longest stretch in the air of each vehicle.

    Positions and attitudes come from the mocap's samples with their own stamps, or without a mocap
    from the agent's ticks.

    Args:
        path: flight folder or MCAP file.
        fleet: the fleet file.
        names: names of the vehicles.

    Returns:
        A log of each vehicle that flew.

    Raises:
        ConfigError: there is no record, or no part of it can be read.
    """
    bodies = {fleet.vehicles[name].body: name for name in names}
    ticks: dict[str, list[Sample]] = {name: [] for name in names}
    poses: dict[str, list[Sample]] = {name: [] for name in names}
    with contextlib.closing(Timeline(path)) as timeline:
        for sample in timeline.samples(("tick", "mocap")):
            if sample.topic == "tick" and sample.name in ticks:
                ticks[sample.name].append(sample)
            elif sample.topic == "mocap" and sample.name in bodies and _is_tracked(sample):
                poses[bodies[sample.name]].append(sample)

    logs: dict[str, Log] = {}
    for name in names:
        _, _, start_m = fleet.vehicles[name].start_enu_m
        log = _log(ticks[name], poses[name], start_m)
        if log is not None:
            logs[name] = log
    return logs


def _log(ticks: list[Sample], poses: list[Sample], start_m: float) -> Log | None:
    """Return the longest stretch in the air of one vehicle; None if it has hardly flown.

    Args:
        ticks: its ticks.
        poses: its poses of the mocap.
        start_m: height of its take-off spot.
    """
    air = _longest_stretch([tick for tick in ticks if _is_flying(tick, start_m + _LOW_M)])
    if len(air) < 2:
        return None

    origin_ns = air[0].stamp_ns
    last_ns = air[-1].stamp_ns
    time_s, (command, attitude, position) = _series(
        air, origin_ns, (*_QUATERNIONS, "position_enu_m")
    )
    thrust = np.array([tick.values["setpoint_thrust_frac"] for tick in air], np.float64)

    tracked = [pose for pose in poses if origin_ns <= pose.stamp_ns <= last_ns]
    # without a mocap, or with too few poses, attitudes and positions come from the ticks
    if len(tracked) < 0.5 * len(air):
        return Log(
            command_time_s=time_s,
            command_quaternion_wxyz=command,
            thrust_frac=thrust,
            attitude_time_s=time_s,
            attitude_quaternion_wxyz=attitude,
            position_time_s=time_s,
            position_enu_m=position,
            attitude_age_s=_LINK_AGE_S,
            attitude_age_std_s=_LINK_AGE_STD_S,
        )

    pose_s, (rotation, path) = _series(
        tracked, origin_ns, ("quaternion_enu_flu_wxyz", "position_enu_m")
    )
    return Log(
        command_time_s=time_s,
        command_quaternion_wxyz=command,
        thrust_frac=thrust,
        attitude_time_s=pose_s,
        attitude_quaternion_wxyz=rotation,
        position_time_s=pose_s,
        position_enu_m=path,
    )


def _is_flying(tick: Sample, least_m: float) -> bool:
    """Return whether a vehicle flies above a height at a tick, and the tick has all values."""
    values = tick.values
    fields = ("position_enu_m", *_QUATERNIONS, "setpoint_thrust_frac")
    if not _are_numbers(values, *fields, count=3 + 4 + 4 + 1):
        return False
    is_up = bool(values["position_enu_m"][2] > least_m)
    return is_up and values.get("state") in ("flying", "holding", "taking off")


def _is_tracked(pose: Sample) -> bool:
    """Return whether the mocap saw the body, and the pose has all values."""
    is_whole = _are_numbers(pose.values, "position_enu_m", "quaternion_enu_flu_wxyz", count=3 + 4)
    return is_whole and bool(pose.values.get("is_tracked"))


def _are_numbers(values: Mapping[str, Any], *fields: str, count: int) -> bool:
    """Return whether the fields together hold ``count`` believable numbers.

    A number that is not finite is null in a record, so it does not count. Numbers beyond _LARGEST
    do not count either: the squares of a fit would overflow, and the fit might not return.
    """
    numbers: list[Any] = []
    for field in fields:
        value = values.get(field)
        if isinstance(value, list):
            numbers += value
        else:
            numbers.append(value)
    return len(numbers) == count and all(_is_believable(number) for number in numbers)


def _is_believable(number: Any) -> bool:
    return isinstance(number, int | float) and -_LARGEST < number < _LARGEST


def _longest_stretch(ticks: list[Sample]) -> list[Sample]:
    """Return the longest run of ticks without a gap."""
    ticks = sorted(ticks, key=lambda tick: tick.stamp_ns)
    best: list[Sample] = []
    stretch: list[Sample] = []
    for tick in ticks:
        if stretch and not 0 < tick.stamp_ns - stretch[-1].stamp_ns < _GAP_S * 1e9:
            stretch = []
        stretch.append(tick)
        if len(stretch) > len(best):
            best = stretch
    return best


def _series(
    samples: list[Sample], origin_ns: int, fields: Sequence[str]
) -> tuple[Array, list[Array]]:
    """Return increasing times (n,) since the origin, and the values (n, ...) of each field."""
    stamps, first = np.unique([sample.stamp_ns for sample in samples], return_index=True)
    columns = [
        np.array([samples[index].values[field] for index in first], np.float64) for field in fields
    ]
    return np.asarray((stamps - origin_ns) * 1e-9, dtype=np.float64), columns
