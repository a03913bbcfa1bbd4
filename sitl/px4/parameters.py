"""PX4's parameters that the emulator honours or that clients ask for, with PX4's names and defaults."""

from __future__ import annotations

import math
import struct
import tomllib
import zlib
from collections import ChainMap
from dataclasses import dataclass, field
from importlib.resources import files

MAV_PARAM_TYPE_UINT32 = 5
MAV_PARAM_TYPE_INT32 = 6
MAV_PARAM_TYPE_REAL32 = 9
HASH_CHECK = "_HASH_CHECK"

# PX4 raises it to the largest delay of any sensor, used or not: that of satellites.
_LEAST = {"EKF2_DELAY_MAX": 110.0}
_GROUPS: dict[str, dict[str, int | float]] = tomllib.loads(files(__package__).joinpath("parameters.toml").read_text())
DEFAULTS: dict[str, int | float] = dict(sorted(ChainMap(*_GROUPS.values()).items()))
_NAMES: tuple[str, ...] = tuple(DEFAULTS)
_INDICES: dict[str, int] = {name: index for index, name in enumerate(_NAMES)}


@dataclass(slots=True)
class Parameters:
    """Values of one vehicle for this run."""

    values: dict[str, int | float] = field(default_factory=lambda: dict(DEFAULTS))

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def integer(self, name: str) -> int:
        """A parameter that is a choice or a set of bits."""
        return int(self.values[name])

    def names(self) -> list[str]:
        """All names in PX4's order (alphabetical)."""
        return list(_NAMES)

    def index(self, name: str) -> int:
        """Index of a known parameter in that order."""
        return _INDICES[name]

    def kind(self, name: str) -> int:
        """MAV_PARAM_TYPE of a known parameter."""
        return MAV_PARAM_TYPE_INT32 if isinstance(DEFAULTS[name], int) else MAV_PARAM_TYPE_REAL32

    def encoded_value(self, name: str) -> float:
        """The value as MAVLink's float field carries it: integers bytewise, not converted."""
        value = self.values[name]
        if isinstance(DEFAULTS[name], int):
            return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])
        return value

    def hash_value(self) -> float:
        """Checksum of all names and values, as :data:`HASH_CHECK` carries it: an unsigned integer, bytewise."""
        checksum = 0
        for name in _NAMES:
            packed = struct.pack("<i" if isinstance(DEFAULTS[name], int) else "<f", self.values[name])
            checksum = zlib.crc32(name.encode("ascii") + packed, checksum)
        # One bit is given away so that the four bytes are never a NaN, which does not survive being a float.
        return float(struct.unpack("<f", struct.pack("<I", checksum & 0xBFFFFFFF))[0])

    def set_encoded(self, name: str, encoded: float, kind: int) -> bool:
        """Take a PARAM_SET; False when name or type is not one that PX4 would accept. NaN leaves the value."""
        if name not in self.values or kind != self.kind(name):
            return False
        if kind == MAV_PARAM_TYPE_INT32:
            self.values[name] = int(struct.unpack("<i", struct.pack("<f", encoded))[0])
        elif math.isfinite(encoded):
            self.values[name] = max(float(encoded), _LEAST.get(name, -math.inf))
        return True
