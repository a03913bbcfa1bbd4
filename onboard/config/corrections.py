"""``[corrections]`` of a fleet file: the source of RTK corrections, and what a flight requires.

One node (``covey corrections``) reads the source and publishes it once on the bus. Each agent gives
the corrections to its own PX4. The password of an NTRIP caster is never in the fleet file: the node
reads it from another file or from its environment. The fleet's hash contains only the values that
agents use in their decisions.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from typing import Literal

import msgspec

from onboard.config.earth import ALTITUDES_M, Origin, is_on_earth
from onboard.config.toml_reading import bound_problems

PASSWORD_VARIABLE = "COVEY_NTRIP_PASSWORD"  # environment variable of that node
BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)

BOUNDS: dict[str, tuple[float, float]] = {
    "max_age_s": (2.0, 120.0),
    "max_base_km": (0.01, 200.0),
    "base_tolerance_m": (0.02, 100.0),
    "hold_accuracy_m": (0.02, 0.7),
}

_HOST_AND_PORT = re.compile(r"(?:[A-Za-z0-9._-]{1,253}|\[[0-9A-Fa-f:.]{2,45}\]):(?P<port>\d{1,5})")
_MOUNTPOINT = re.compile(r"[A-Za-z0-9_.-]{1,100}")
_USER = re.compile(r"[!-9;-~]{1,100}")  # printable, without the colon that ends a user in HTTP
_OF_NTRIP = ("mountpoint", "user", "password_file", "tls", "sends_position")


class CorrectionsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``[corrections]``: docs/corrections.md explains each key."""

    # a receiver on a cable, a caster of NTRIP, a server that sends RTCM over TCP, a recording, or a
    # base that is made up
    source: Literal["serial", "ntrip", "tcp", "file", "mock"]
    # serial: /dev/ttyUSB0; ntrip and tcp: HOST:PORT; file: a path beside this file; mock: none
    address: str = ""
    baud: int = 115200  # serial only
    mountpoint: str = ""  # ntrip only, like the four keys below
    user: str = ""  # your user name at the caster
    # file beside this one with the password in its first line, readable by its owner only; without
    # it the node reads the environment variable COVEY_NTRIP_PASSWORD
    password_file: str = ""
    tls: bool = False  # the caster uses TLS
    # the fleet's origin is sent to the caster, which then makes corrections for that position
    sends_position: bool = False
    # worst fix of PX4's receiver that allows a take-off; a worse fix in flight triggers a failsafe
    fix: Literal["any", "rtk_float", "rtk_fixed"] = "any"
    max_age_s: float = 10.0  # if a fix is required, no vehicle takes off with older corrections
    max_base_km: float = 20.0  # no vehicle takes off if the base is farther away
    # surveyed latitude and longitude of the base; PX4 gets no corrections from a base at another
    # position
    base_deg: tuple[float, float] | None = None
    # its height above the ellipsoid of WGS 84, not above the sea; without it no height is compared
    base_height_m: float | None = None
    # largest error of a base's position, and largest motion of a base while a vehicle flies
    base_tolerance_m: float = 2.0
    # a vehicle with a worse fix holds if its position error, over both axes together, exceeds this
    hold_accuracy_m: float = 0.5

    @property
    def judged(self) -> tuple[object, ...]:
        """Values that agents use in their decisions. All vehicles of a fleet have the same
        values.
        """
        return (
            self.fix,
            self.max_age_s,
            self.max_base_km,
            self.base_deg,
            self.base_height_m,
            self.base_tolerance_m,
            self.hold_accuracy_m,
        )


def problems(corrections: CorrectionsConfig | None, origin: Origin | None) -> Iterator[str]:
    """Check the table.

    Args:
        corrections: the table; None where the file has none.
        origin: origin of the fleet frame on Earth, if the file has one.
    Yields:
        a sentence for each mistake.
    """
    if corrections is None:
        return
    yield from _source_problems(corrections, origin)
    for key, (low, high) in BOUNDS.items():
        yield from bound_problems(f"corrections.{key}", getattr(corrections, key), low, high)

    base_deg = corrections.base_deg
    if base_deg is not None and not is_on_earth(*base_deg):
        yield (
            f"'corrections.base_deg' is {list(base_deg)}, which is no place on Earth. Give "
            "[latitude, longitude] of the surveyed point."
        )
    height_m = corrections.base_height_m
    if height_m is not None:
        yield from bound_problems("corrections.base_height_m", height_m, *ALTITUDES_M)
        if base_deg is None:
            yield (
                "'corrections.base_height_m' is given without 'corrections.base_deg'. Give the "
                "surveyed point as well, or remove the height."
            )


def _source_problems(corrections: CorrectionsConfig, origin: Origin | None) -> Iterator[str]:
    """Yield a sentence for each mistake in the keys of the source."""
    source = corrections.source
    if source in ("ntrip", "tcp"):
        match = _HOST_AND_PORT.fullmatch(corrections.address)
        if match is None or not 0 < int(match["port"]) < 65536:
            yield (
                f"'corrections.address' is {corrections.address!r}; {source} needs HOST:PORT, for "
                'instance address = "caster.example.org:2101".'
            )
    elif source != "mock" and not corrections.address.strip():
        yield "'corrections.address' is empty. Name the device or the file to read."

    if corrections.baud not in BAUDS:
        rates = ", ".join(map(str, BAUDS))
        yield f"'corrections.baud' is {corrections.baud}; it is one of {rates}."

    if source != "ntrip":
        for key in _OF_NTRIP:
            if getattr(corrections, key):
                yield (
                    f"'corrections.{key}' is given, but 'corrections.source' is '{source}'. Only "
                    "ntrip has it: remove the key."
                )
        return

    if not _MOUNTPOINT.fullmatch(corrections.mountpoint):
        yield (
            f"'corrections.mountpoint' is {corrections.mountpoint!r}; ntrip needs one of A-Z a-z "
            "0-9 _ . -, as the caster's list names it."
        )
    if corrections.user and not _USER.fullmatch(corrections.user):
        yield (
            "'corrections.user' has characters that a caster does not take: letters, digits and "
            "signs without blanks and colons are taken."
        )
    if corrections.sends_position and origin is None:
        yield (
            "'corrections.sends_position' needs the fleet's place on Earth: give fleet.origin as "
            "{ latitude_deg, longitude_deg, altitude_m }, or remove the key."
        )


def beside(fleet_path: str, path: str) -> str:
    """Return a path that a fleet file names. The name is relative to the folder of that file."""
    return os.path.join(os.path.dirname(os.path.abspath(fleet_path)), path)
