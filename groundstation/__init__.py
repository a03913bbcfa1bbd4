"""The ground station: the operator's client, console, missions, records and the covey command."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from groundstation.missions.api import Fleet as Fleet
    from groundstation.missions.blocking import BlockingFleet as BlockingFleet

_HERE = {"Fleet": "groundstation.missions.api", "BlockingFleet": "groundstation.missions.blocking"}


def __getattr__(name: str) -> object:
    """Import the door of scripts when it is used: a drone's computer has none of what it needs."""
    if name not in _HERE:
        raise AttributeError(f"module 'groundstation' has no attribute '{name}'")
    return getattr(importlib.import_module(_HERE[name]), name)
