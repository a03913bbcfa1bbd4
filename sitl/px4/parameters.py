"""PX4's parameters that the emulator obeys or that clients request, with PX4's defaults.

MAVLink sends every value in a float field. PX4 copies the bytes of an integer into the field
instead of converting the number. The type of a parameter therefore decides how its value is
encoded.
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
_NEVER_NAN = 0xBFFFFFFF  # clears the highest bit of a float's exponent

_GROUPS: dict[str, dict[str, int | float]] = tomllib.loads(
    files(__package__).joinpath("parameters.toml").read_text()
)


def _defaults(version: Version) -> dict[str, int | float]:
    """Return a version's defaults in alphabetical order; its own values replace the common ones."""
    values = ChainMap(dict(version.parameters), *_GROUPS.values()).items()
    return {name: value for name, value in sorted(values) if name not in version.parameters_gone}


# Defaults of each version, in PX4's order.
DEFAULTS: dict[str, dict[str, int | float]] = {
    version.name: _defaults(version) for version in versions.VERSIONS.values()
}


@dataclass(slots=True)
class Parameters:
    """Parameters of one vehicle."""

    version: Version = versions.DEFAULT
    # Values by name, initially the defaults of the version.
    values: dict[str, int | float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.values = {**self.defaults, **self.values}

    @property
    def defaults(self) -> dict[str, int | float]:
        """Default values of this version of PX4."""
        return DEFAULTS[self.version.name]

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def integer(self, name: str) -> int:
        """Return a parameter that is a choice or a set of bits."""
        return int(self.values[name])

    def names(self) -> list[str]:
        """Return all names in PX4's order, which is alphabetical."""
        return list(self.defaults)

    def index(self, name: str) -> int:
        """Return the index of a known parameter in the order of :meth:`names`."""
        return list(self.defaults).index(name)

    def kind(self, name: str) -> int:
        """Return the MAV_PARAM_TYPE of a known parameter."""
        if isinstance(self.defaults[name], int):
            return MAV_PARAM_TYPE_INT32
        return MAV_PARAM_TYPE_REAL32

    def encoded_value(self, name: str) -> float:
        """Return the value for MAVLink's float field, which has the bytes of an integer."""
        value = self.values[name]
        if isinstance(self.defaults[name], int):
            (encoded,) = struct.unpack("<f", struct.pack("<i", int(value)))
            return float(encoded)
        return value

    def hash_value(self) -> float:
        """Return the checksum of all names and values, as :data:`HASH_CHECK` carries it."""
        checksum = 0
        for name in self.defaults:
            layout = "<f"
            if isinstance(self.defaults[name], int):
                layout = "<i"
            packed = struct.pack(layout, self.values[name])
            checksum = zlib.crc32(name.encode("ascii") + packed, checksum)

        # Clear one bit, so that the four bytes never form a NaN. Python can change the bytes of a
        # NaN when it converts them to a float.
        checksum &= _NEVER_NAN
        (encoded,) = struct.unpack("<f", struct.pack("<I", checksum))
        return float(encoded)

    def set_encoded(self, name: str, encoded: float, kind: int) -> bool:
        """Set the value of a PARAM_SET; return False for a name or type that PX4 does not accept.

        PX4 accepts a NaN without changing the value.
        """
        if name not in self.values or kind != self.kind(name):
            return False

        if kind == MAV_PARAM_TYPE_INT32:
            (value,) = struct.unpack("<i", struct.pack("<f", encoded))
            self.values[name] = int(value)
        elif math.isfinite(encoded):
            least = self.version.parameters_least.get(name, -math.inf)
            self.values[name] = max(float(encoded), least)
        return True
