"""A stretch of a check: the facts it settles and how it settles them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sitl.conformance.facts import Fact, FactReport
from sitl.conformance.vehicle_client import VehicleClient


@dataclass(frozen=True, slots=True)
class FactGroup:
    """One stretch."""

    name: str  # for people
    facts: tuple[Fact, ...]  # settled here; those that were asked for decide whether it runs at all
    run: Callable[[VehicleClient, FactReport], None]  # measures and reports
    turns_motors: bool = True  # motors spin; only done with a vehicle that is simulated
