"""Makes the keys of MAVLink signing, one for each vehicle (``covey keys secure --mavlink``)."""

from __future__ import annotations

import secrets
from pathlib import Path

from groundstation.keys.key_folder import make_key_folder, write_files
from groundstation.keys.secured_fleet import refuse_example
from groundstation.starter.fleet_edit import checked_edit, write_text
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.config.validation import PX4_WITHOUT_SIGNING
from onboard.security.mavlink_key import KEY_BYTES, key_file, read_key


def sign_mavlink(path: str) -> FleetConfig:
    """Make the missing keys, and set ``mavlink_signing`` of all vehicles in the fleet file.

    A second call changes nothing.

    Args:
        path: path of the fleet file, which is changed; its comments remain.

    Returns:
        The changed fleet.

    Raises:
        ConfigError: the fleet file is wrong, is an example, or names a PX4 that cannot sign.
    """
    fleet = load_fleet(path)
    refuse_example(fleet)

    for name, vehicle in fleet.vehicles.items():
        if vehicle.px4_version in PX4_WITHOUT_SIGNING:
            raise ConfigError(
                f"--mavlink: '{name}' flies PX4 v{vehicle.px4_version}, which cannot sign MAVLink. "
                'Fly v1.18, and write px4_version = "1.18" in its table or its type; without '
                'px4_version it counts as "1.17". Nothing was changed.'
            )

    unsigned = [name for name, vehicle in fleet.vehicles.items() if not vehicle.mavlink_signing]
    tables = {name: {"mavlink_signing": True} for name in unsigned}
    text = checked_edit(Path(fleet.path), {"vehicles": tables})

    # The keys come first: without its key an agent of a vehicle that signs does not start.
    folder = Path(fleet.keys_folder)
    make_key_folder(folder)
    for name in fleet.vehicles:
        file = folder / key_file(name)
        if file.exists():
            read_key(str(file), fleet.path)  # refuses a file that is not a key
        else:
            write_files({file: secrets.token_bytes(KEY_BYTES)})

    if unsigned:
        write_text(Path(fleet.path), text)
    return load_fleet(path)
