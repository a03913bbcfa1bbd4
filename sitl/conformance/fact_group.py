"""A group of facts: what it settles, and how."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sitl.conformance.facts import Fact, FactReport
from sitl.conformance.vehicle_client import VehicleClient


@dataclass(frozen=True, slots=True)
class FactGroup:
    """Facts that are settled together, in one go with one vehicle."""

    name: str  # for people
    facts: tuple[Fact, ...]  # the group runs when one of them was requested
    run: Callable[[VehicleClient, FactReport], None]  # measures and reports
    turns_motors: bool = True  # motors spin; only done with a vehicle that is simulated
