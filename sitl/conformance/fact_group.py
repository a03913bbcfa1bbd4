"""A group of facts, and the function that measures them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sitl.conformance.facts import Fact, FactReport
from sitl.conformance.vehicle_client import VehicleClient


@dataclass(frozen=True, slots=True)
class FactGroup:
    """Facts that are measured together with one vehicle."""

    name: str  # name in sentences
    facts: tuple[Fact, ...]  # the group runs when one of its facts is requested
    run: Callable[[VehicleClient, FactReport], None]  # function that measures and reports
    turns_motors: bool = True  # whether motors turn, which needs a simulated vehicle
