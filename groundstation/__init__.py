"""The ground station: the operator's client, console, missions, records and the covey command."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from groundstation.missions.api import Fleet as Fleet
    from groundstation.missions.blocking import BlockingFleet as BlockingFleet

_MODULE_BY_NAME = {
    "Fleet": "groundstation.missions.api",
    "BlockingFleet": "groundstation.missions.blocking",
}


def __getattr__(name: str) -> object:
    """Import Fleet or BlockingFleet at first use.

    A drone's computer does not have the libraries that these two need.
    """
    if name not in _MODULE_BY_NAME:
        raise AttributeError(f"module 'groundstation' has no attribute '{name}'")
    return getattr(importlib.import_module(_MODULE_BY_NAME[name]), name)
