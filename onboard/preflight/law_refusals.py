"""Findings of feasibility that refuse take-off: of the fleet file, and of the spots where vehicles
stand.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from onboard.config.fleet import FleetConfig, Vec3
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility.finding import Finding
from onboard.feasibility.fleet_checks import error_class, fleet_findings, start_finding
from onboard.neighbours.table import NeighbourTable

Refusal = tuple[str, str, str]  # name, sentence, remedy
# hash of a fleet file -> refusals, for the many agents of a simulation
_judged: dict[str, tuple[Refusal, ...]] = {}


class LawRefusals:
    """Refusals for one vehicle; the fleet file is judged once, when they are first read."""

    def __init__(self, fleet: FleetConfig, vehicle: str, neighbours: NeighbourTable) -> None:
        self._fleet = fleet
        self._vehicle, self._neighbours = vehicle, neighbours
        self._of_fleet: tuple[Refusal, ...] | None = None
        self._of_spots: tuple[Refusal, ...] = ()

    @property
    def current(self) -> tuple[Refusal, ...]:
        """Name, sentence and remedy of each finding that refuses."""
        if self._of_fleet is None:
            key = self._fleet.config_hash
            if key not in _judged:
                _judged.clear()  # agents of one process fly one fleet
                _judged[key] = _refusals(fleet_findings(self._fleet))
            self._of_fleet = _judged[key]
        return self._of_fleet + self._of_spots

    def judge_spot(self, position_enu_m: Vec3 | None) -> None:
        """Judge the distance from where the vehicle stands to the nearest other one on the ground;
        None: unknown.
        """
        self._of_spots = ()
        others = {
            name: telemetry.position_enu_m
            for name, telemetry in self._neighbours.telemetries().items()
            if telemetry.is_position_valid and not telemetry.is_airborne
        }
        if position_enu_m is None or not others:
            return
        own = position_enu_m
        nearest = min(others, key=lambda name: math.dist(own[:2], others[name][:2]))
        spots = {self._vehicle: own, nearest: others[nearest]}
        self._of_spots = _refusals(
            (start_finding(self._fleet, spots, ACCURACIES[error_class(self._fleet)]),)
        )


def _refusals(findings: Iterable[Finding]) -> tuple[Refusal, ...]:
    return tuple(
        (f.name, f.sentence.removesuffix(f" {f.remedy}"), f.remedy)
        for f in findings
        if f.status == "refused"
    )
