"""``[mocap]`` of a fleet file: the motion capture, the program that reads it, and its frame."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Literal, get_args

import msgspec

from onboard.config.toml_reading import bound_problems

SystemType = Literal["optitrack", "vicon", "qualisys", "vrpn", "motionanalysis", "mock"]
BODY_NAME = r"[A-Za-z0-9_.:-]{1,60}"  # a body's name is part of a key on the bus
BOUNDS: dict[str, tuple[float, float]] = {
    "yaw_deg": (-360.0, 360.0),
    "offset_m": (-1e4, 1e4),
    "latency_s": (0.0, 0.5),
    "max_rate_hz": (20.0, 1000.0),
}

# keys that say how a system is read; they are meaningless if poses come from the bus
_OF_A_SYSTEM = ("type", "hostname", "options", "direct", "up", "yaw_deg", "offset_m")


class MocapConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[mocap]``: docs/mocap.md explains each key."""

    # "bus": another program publishes mocap/<body> in the fleet's frame;
    # "motioncapture": the package motioncapture reads a system
    source: Literal["bus", "motioncapture"] = "bus"
    type: SystemType | None = None  # system that the package reads
    hostname: str | None = None  # of that system
    # further options of the package for that system
    options: dict[str, str | int | float | bool] = {}
    # true: every agent reads the system itself; false: one relay (covey mocap) reads it and
    # publishes the poses
    direct: bool = False
    up: Literal["z", "y"] = "z"  # axis of the mocap's frame that points up
    # then the mocap's frame is turned about the up axis by this angle, counterclockwise
    yaw_deg: float = 0.0
    # the mocap's origin in the fleet's frame, ENU
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    latency_s: float = 0.010  # from exposure to arrival; a sample's stamp is its arrival minus this
    max_rate_hz: float = 100.0  # frames beyond this rate are skipped; the control needs 50 Hz


def problems(mocap: MocapConfig, bodies: Mapping[str, str | None]) -> Iterator[str]:
    """Check the table and the names of the bodies.

    Args:
        mocap: the table.
        bodies: key of a vehicle or person, for instance ``vehicles.mav0`` -> body; None for a
            vehicle without a mocap.
    Yields:
        a sentence for each mistake.
    """
    yield from _system_problems(mocap)

    for key, (low, high) in BOUNDS.items():
        value = getattr(mocap, key)
        if isinstance(value, tuple):
            for axis, number in enumerate(value):
                yield from bound_problems(f"mocap.{key}[{axis}]", number, low, high)
        else:
            yield from bound_problems(f"mocap.{key}", value, low, high)

    yield from _body_problems(bodies)


def _system_problems(mocap: MocapConfig) -> Iterator[str]:
    """Yield a sentence for each missing key of a system, and for each meaningless key."""
    if mocap.source == "bus":
        default = MocapConfig()
        for key in _OF_A_SYSTEM:
            if getattr(mocap, key) != getattr(default, key):
                yield (
                    f"'mocap.{key}' is given, but 'mocap.source' is 'bus', where poses come in the "
                    'fleet\'s frame already. Set mocap.source = "motioncapture", or remove the key.'
                )
    elif mocap.type is None:
        yield f"'mocap.type' is missing: one of {', '.join(get_args(SystemType))}."
    elif mocap.type != "mock" and not mocap.hostname:
        yield (
            "'mocap.hostname' is missing: the name or address of the computer on which "
            f"{mocap.type} runs."
        )


def _body_problems(bodies: Mapping[str, str | None]) -> Iterator[str]:
    """Yield a sentence for each body that two keys share, or that has an invalid name."""
    owners: dict[str, str] = {}  # body -> key
    for key, body in bodies.items():
        if body is None:
            continue

        owner = owners.setdefault(body, key)
        if owner != key:
            yield (
                f"'{key}' and '{owner}' have the same mocap body {body!r} (without mocap_body it "
                "is the name in the file). Give each its own."
            )
        if not re.fullmatch(BODY_NAME, body):
            yield (
                f"'{key}.mocap_body' is {body!r}; a body has 1 to 60 of "
                "A-Z a-z 0-9 _ . : - as its name. Rename it in the mocap's software and here."
            )
