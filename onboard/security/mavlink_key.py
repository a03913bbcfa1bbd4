"""Keys of MAVLink signing: ``keys/VEHICLE.mavlink.key`` beside the fleet file.

PX4 remembers the newest timestamp of each sender (system, component, link id), and refuses messages
with older timestamps. If two programs shared a link id, PX4 would refuse the program whose clock is
behind. So every program that sends over a vehicle's links has its own link id.

The format of signatures: https://mavlink.io/en/guide/message_signing.html
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable

from onboard.config.file_reading import KEY_FILE, read_bytes
from onboard.config.fleet_config import FleetConfig
from onboard.config.toml_reading import ConfigError
from onboard.security.private_files import refuse_open_to_others

KEY_BYTES = 32

# Link ids. PX4 itself uses 0 to 5.
AGENT_LINK_ID = 10  # the agent of a vehicle
TOOL_LINK_ID = 11  # tools for parameters and calibration

# Ground computers send to PX4 directly, without the agent.
_FIRST_GROUND_LINK_ID = 64
_GROUND_LINK_ID_COUNT = 128

_EPOCH_S = 1_420_070_400  # start of 2015, where timestamps start [s since 1970]
_STEPS_PER_S = 100_000  # timestamps count in steps of 10 us


def key_file(vehicle: str) -> str:
    """Return the name of a vehicle's key file in the folder of keys."""
    return f"{vehicle}.mavlink.key"


def mavlink_key(fleet: FleetConfig, vehicle: str) -> bytes | None:
    """Read the key of a vehicle whose MAVLink is signed.

    Args:
        fleet: the fleet file.
        vehicle: name of the vehicle.
    Returns:
        the key; None for a vehicle whose MAVLink is not signed.
    Raises:
        ConfigError: the file is missing, readable by other users, or not a key.
    """
    if not fleet.vehicles[vehicle].mavlink_signing:
        return None
    return read_key(os.path.join(fleet.keys_folder, key_file(vehicle)), fleet.path)


def mavlink_keys(fleet: FleetConfig, vehicles: Iterable[str] | None = None) -> dict[str, bytes]:
    """Read the keys of vehicles whose MAVLink is signed, like :func:`mavlink_key`.

    Args:
        fleet: the fleet file.
        vehicles: names of the vehicles; None: all vehicles of the fleet.
    Returns:
        vehicle -> key.
    """
    keys: dict[str, bytes] = {}
    if vehicles is None:
        vehicles = fleet.vehicles
    for name in vehicles:
        key = mavlink_key(fleet, name)
        if key is not None:
            keys[name] = key
    return keys


def read_key(path: str, fleet_path: str) -> bytes:
    """Read a key of MAVLink signing.

    Args:
        path: path of the key's file.
        fleet_path: path of the fleet file, for the sentences.
    Returns:
        the key.
    Raises:
        ConfigError: the file is missing, readable by other users, or not a key.
    """
    try:
        refuse_open_to_others(path)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read ({error.strerror}): it is the key of a vehicle whose MAVLink "
            "is signed. Copy it from the computer that has it, or make a new key there: "
            f"covey keys secure {fleet_path} --mavlink"
        ) from None
    key = read_bytes(path, KEY_FILE._replace(words="key of MAVLink"))

    if len(key) != KEY_BYTES or not any(key):
        raise ConfigError(
            f"{path} holds no key: a key of MAVLink has {KEY_BYTES} bytes, not all of them zero. "
            "Copy it once more."
        )
    return key


def ground_link_id(host: str) -> int:
    """Return the link id of a ground computer.

    The clocks of two computers differ, so each computer has its own id.

    Args:
        host: name of the computer.
    """
    return _FIRST_GROUND_LINK_ID + zlib.crc32(host.encode()) % _GROUND_LINK_ID_COUNT


def signing_time(unix_ns: int) -> int:
    """Convert a time to a timestamp of MAVLink signing: steps of 10 us since 2015, at least 0.

    Args:
        unix_ns: time [ns since 1970].
    """
    ns_per_step = 1_000_000_000 // _STEPS_PER_S
    since_epoch_ns = unix_ns - _EPOCH_S * 1_000_000_000
    return max(0, since_epoch_ns // ns_per_step)
