"""Keys of MAVLink signing: a file ``keys/VEHICLE.mavlink.key`` beside the fleet file, for vehicles
that sign.

Who signs what is told apart by link ids: PX4 remembers the newest timestamp of each sender (system,
component, link id) and refuses older ones. So every program of a vehicle's links has an id of its
own, and its clock decides alone.
"""

from __future__ import annotations

import os
import stat
import zlib

from onboard.config.fleet_config import FleetConfig
from onboard.config.toml_reading import ConfigError

KEY_BYTES = 32
AGENT_LINK_ID, TOOL_LINK_ID, CHECK_LINK_ID = 10, 11, 12  # PX4's own are 0 to 5
_FIRST_GROUND_LINK_ID, _GROUND_LINK_IDS = 64, 128
_BEGIN_S = 1_420_070_400  # timestamps count from 2015 in steps of 10 us
_STEPS_PER_S = 100_000


def key_file(vehicle: str) -> str:
    """Return the name of a vehicle's key file in the folder of keys."""
    return f"{vehicle}.mavlink.key"


def mavlink_key(fleet: FleetConfig, vehicle: str) -> bytes | None:
    """Read the key of a vehicle whose MAVLink is signed.

    Args:
        fleet: the fleet file.
        vehicle: its name.
    Returns:
        the key; None for a vehicle that does not sign.
    Raises:
        ConfigError: the file is missing, open to others, or no key.
    """
    if not fleet.vehicles[vehicle].mavlink_signing:
        return None
    return read_key(os.path.join(fleet.keys_folder, key_file(vehicle)), fleet.path)


def mavlink_keys(fleet: FleetConfig) -> dict[str, bytes]:
    """Read the keys of all vehicles whose MAVLink is signed, as :func:`mavlink_key` does.

    Args:
        fleet: the fleet file.
    Returns:
        vehicle -> key.
    """
    keys = {name: mavlink_key(fleet, name) for name in fleet.vehicles}
    return {name: key for name, key in keys.items() if key is not None}


def read_key(path: str, fleet_path: str) -> bytes:
    """Read a key.

    Args:
        path: of its file.
        fleet_path: of the fleet file, for the sentences.
    Returns:
        the key.
    Raises:
        ConfigError: the file is missing, open to others, or no key.
    """
    try:
        mode = stat.S_IMODE(os.stat(path).st_mode)
        with open(path, "rb") as file:
            key = file.read(KEY_BYTES + 1)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read ({error.strerror}): it is the key of a vehicle whose MAVLink is signed. Copy it "
            f"from the computer that has it, or make a new key there: covey secure {fleet_path} --mavlink"
        ) from None
    if mode & 0o077:
        raise ConfigError(
            f"{path} can be read by other users of this computer (mode {mode:o}). Run: chmod 600 {path}"
        )
    if len(key) != KEY_BYTES or not any(key):
        raise ConfigError(
            f"{path} holds no key: a key of MAVLink has {KEY_BYTES} bytes, not all of them zero. Copy it once more."
        )
    return key


def ground_link_id(host: str) -> int:
    """Return the link id of a ground computer: clocks of two computers differ, so each has an id of
    its own.

    Args:
        host: name of the computer.
    """
    return _FIRST_GROUND_LINK_ID + zlib.crc32(host.encode()) % _GROUND_LINK_IDS


def signing_time(unix_ns: int) -> int:
    """Return the timestamp of MAVLink signing [10 us since 2015] of a time; 0 before 2015.

    Args:
        unix_ns: time [ns since 1970].
    """
    return max(0, (unix_ns - _BEGIN_S * 1_000_000_000) // (1_000_000_000 // _STEPS_PER_S))
