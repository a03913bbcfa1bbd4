"""PX4's parameters that the emulator honours or that clients ask for, with PX4's names and
defaults.
"""

from __future__ import annotations

import math
import struct
import tomllib
import zlib
from collections import ChainMap
from dataclasses import dataclass, field
from importlib.resources import files

from sitl.px4 import versions
from sitl.px4.versions import Version

MAV_PARAM_TYPE_UINT32 = 5
MAV_PARAM_TYPE_INT32 = 6
MAV_PARAM_TYPE_REAL32 = 9
HASH_CHECK = "_HASH_CHECK"

_GROUPS: dict[str, dict[str, int | float]] = tomllib.loads(
    files(__package__).joinpath("parameters.toml").read_text()
)


def _defaults(version: Version) -> dict[str, int | float]:
    named = ChainMap(dict(version.parameters), *_GROUPS.values()).items()
    return {name: value for name, value in sorted(named) if name not in version.parameters_gone}


DEFAULTS: dict[str, dict[str, int | float]] = {
    version.name: _defaults(version) for version in versions.VERSIONS.values()
}  # of each version, in PX4's order


@dataclass(slots=True)
class Parameters:
    """Values of one vehicle for this run."""

    version: Version = versions.DEFAULT
    # the version's defaults at the start
    values: dict[str, int | float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.values = {**self.defaults, **self.values}

    @property
    def defaults(self) -> dict[str, int | float]:
        """Values of a PX4 of this version that nobody has changed."""
        return DEFAULTS[self.version.name]

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def integer(self, name: str) -> int:
        """A parameter that is a choice or a set of bits."""
        return int(self.values[name])

    def names(self) -> list[str]:
        """All names in PX4's order (alphabetical)."""
        return list(self.defaults)

    def index(self, name: str) -> int:
        """Index of a known parameter in that order."""
        return list(self.defaults).index(name)

    def kind(self, name: str) -> int:
        """MAV_PARAM_TYPE of a known parameter."""
        return (
            MAV_PARAM_TYPE_INT32 if isinstance(self.defaults[name], int) else MAV_PARAM_TYPE_REAL32
        )

    def encoded_value(self, name: str) -> float:
        """The value as MAVLink's float field carries it: integers bytewise, not converted."""
        value = self.values[name]
        if isinstance(self.defaults[name], int):
            return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])
        return value

    def hash_value(self) -> float:
        """Checksum of all names and values, as :data:`HASH_CHECK` carries it: an unsigned integer,
        bytewise.
        """
        checksum = 0
        for name in self.defaults:
            packed = struct.pack(
                "<i" if isinstance(self.defaults[name], int) else "<f", self.values[name]
            )
            checksum = zlib.crc32(name.encode("ascii") + packed, checksum)
        # One bit is given away so that the four bytes are never a NaN, which does not survive being
        # a float.
        return float(struct.unpack("<f", struct.pack("<I", checksum & 0xBFFFFFFF))[0])

    def set_encoded(self, name: str, encoded: float, kind: int) -> bool:
        """Take a PARAM_SET; False when name or type is not one that PX4 would accept. NaN leaves
        the value.
        """
        if name not in self.values or kind != self.kind(name):
            return False
        if kind == MAV_PARAM_TYPE_INT32:
            self.values[name] = int(struct.unpack("<i", struct.pack("<f", encoded))[0])
        elif math.isfinite(encoded):
            self.values[name] = max(
                float(encoded), self.version.parameters_least.get(name, -math.inf)
            )
        return True
