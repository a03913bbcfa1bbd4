"""Feasibility findings that refuse a take-off: about the fleet file, and about take-off spots."""

from __future__ import annotations

import math
from collections.abc import Iterable

from onboard.config.fleet import FleetConfig
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility.finding import Finding
from onboard.feasibility.fleet_checks import error_class, fleet_findings, start_finding
from onboard.feasibility.vehicle_checks import OWN_FAILSAFES
from onboard.neighbours.table import NeighbourTable
from onboard.tuples import Xyz

Refusal = tuple[str, str, str]  # name, sentence, remedy
# hash of the fleet file that was checked last -> its refusals; shared by the many agents of a
# simulation
_cache: dict[str, tuple[Refusal, ...]] = {}


class LawRefusals:
    """Refusals for one vehicle. The fleet file is checked only once, at the first use."""

    def __init__(self, fleet: FleetConfig, vehicle: str, neighbours: NeighbourTable) -> None:
        self._fleet = fleet
        self._vehicle = vehicle
        self._neighbours = neighbours
        self._fleet_refusals: tuple[Refusal, ...] | None = None  # None: not checked yet
        self._spot_refusals: tuple[Refusal, ...] = ()

    @property
    def current(self) -> tuple[Refusal, ...]:
        """Name, sentence and remedy of each finding that refuses."""
        if self._fleet_refusals is None:
            self._fleet_refusals = refusals_of_fleet(self._fleet)
        return self._fleet_refusals + self._spot_refusals

    def judge_spot(self, position_enu_m: Xyz | None) -> None:
        """Check the distance to the nearest other vehicle on the ground.

        Args:
            position_enu_m: position of the vehicle; None if it is not known.
        """
        self._spot_refusals = ()
        others = {}  # vehicle on the ground -> its position
        for name, telemetry in self._neighbours.telemetries().items():
            if telemetry.is_position_valid and not telemetry.is_airborne:
                others[name] = telemetry.position_enu_m
        if position_enu_m is None or not others:
            return

        own_x_y_m = position_enu_m[:2]
        nearest = min(others, key=lambda name: math.dist(own_x_y_m, others[name][:2]))
        spots = {self._vehicle: position_enu_m, nearest: others[nearest]}
        accuracy = ACCURACIES[error_class(self._fleet)]
        self._spot_refusals = _refusals([start_finding(self._fleet, spots, accuracy)])


def refusals_of_fleet(fleet: FleetConfig) -> tuple[Refusal, ...]:
    """Return the findings about a fleet file that refuse a take-off.

    They are kept, because a check takes longer than a tick.

    Args:
        fleet: the fleet file.
    """
    key = fleet.config_hash
    if key not in _cache:
        _cache.clear()  # one entry is enough, because the agents of one process fly one fleet
        _cache[key] = _refusals(fleet_findings(fleet))
    return _cache[key]


def _refusals(findings: Iterable[Finding]) -> tuple[Refusal, ...]:
    """Return the findings that refuse a take-off, with sentence and remedy separated.

    The finding about px4_params is left out, because the rule about parameters reports it.
    """
    refusals = []
    for finding in findings:
        if finding.status == "refused" and finding.name != OWN_FAILSAFES:
            sentence = finding.sentence.removesuffix(f" {finding.remedy}")
            refusals.append((finding.title, sentence, finding.remedy))
    return tuple(refusals)
