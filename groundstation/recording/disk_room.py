"""Whether a disk has room for what a record takes until a flight begins."""

from __future__ import annotations

import shutil
from pathlib import Path

# Measured: a vehicle that stands on the ground takes 93 MB, one that flies 122 MB.
MB_PER_VEHICLE_HOUR = 125.0


def room_warning(folder: Path, *, wait_s: float, vehicles: int) -> str:
    """Return a sentence if the record of a long wait may fill the disk; otherwise nothing.

    Args:
        folder: flight folder.
        wait_s: time until the flight begins [s].
        vehicles: number of recorded vehicles.
    """
    needed_mb = MB_PER_VEHICLE_HOUR * vehicles * wait_s / 3600.0
    free_mb = shutil.disk_usage(folder).free / 1e6
    if needed_mb < free_mb:
        return ""
    return (
        f"The disk of {folder} has {free_mb:.0f} MB free, and the record takes about "
        f"{needed_mb:.0f} MB until the start alone. Free some, or begin nearer to the start: a "
        "flight whose record fails does not pass."
    )
