"""All evidence of a campaign as one value, which ``evidence.json`` stores and the page shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from groundstation.evidence.hazards import NOT_SHOWN
from groundstation.evidence.kept_flights import NOTHING, FlownCase, digest
from groundstation.evidence.matrix import WRONG, MatrixRow, conditions_never_seen, matrix
from groundstation.evidence.proofs import tests_by_condition
from groundstation.evidence.provenance import Provenance
from groundstation.evidence.volumes import Volumes, distance_outside_m, volumes
from onboard.confidence_intervals import upper_bound
from onboard.config.file_reading import EVIDENCE_FILE, read_bytes
from onboard.config.fleet import ConfigError, FleetConfig

EVIDENCE_NAME = "evidence.json"
SCHEMA = 1


class Evidence(msgspec.Struct, frozen=True, kw_only=True):
    """The evidence of one campaign."""

    schema: int
    fleet: str
    mission: str
    vehicles: tuple[str, ...]
    wind_m_s: float
    rounds: int
    command: str  # the command that repeats the campaign
    flights: int
    wrong_flights: int
    digest: str  # digest of all flights
    matrix: tuple[MatrixRow, ...]
    not_shown: tuple[tuple[str, str], ...]  # what no simulation shows, each with the reason
    never_seen: tuple[str, ...]  # conditions that held in no flight
    volumes: Volumes
    # greatest distance of a vehicle's centre outside the geography, for each flight
    excursions_m: tuple[float, ...]
    provenance: Provenance

    @property
    def is_wrong(self) -> bool:
        """Whether any row of the matrix is wrong."""
        return any(row.status == WRONG for row in self.matrix)


def summarized(
    flights: Sequence[FlownCase],
    *,
    fleet: FleetConfig,
    mission: str,
    planned: Sequence[tuple[float, float, float]],
    wind_m_s: float,
    rounds: int,
    command: str,
    made_by: Provenance,
) -> Evidence:
    """Return the evidence of a campaign.

    Args:
        flights: all flights of the campaign.
        fleet: the fleet that flew.
        mission: name of the mission.
        planned: positions that the mission plans, east, north and up [m].
        wind_m_s: mean wind.
        rounds: number of rounds of the campaign.
        command: the command that repeats the campaign.
        made_by: versions, machine and files.
    """
    undisturbed = [flight for flight in flights if flight.case.fault == NOTHING]
    fleet_volumes = volumes(
        planned=planned,
        undisturbed=[point for flight in undisturbed for point in flight.hull_m],
        undisturbed_height_m=max((flight.highest_m for flight in undisturbed), default=0.0),
        flown=[point for flight in flights for point in flight.hull_m],
        highest_m=max((flight.highest_m for flight in flights), default=0.0),
        fastest_m_s=max((flight.fastest_m_s for flight in flights), default=0.0),
        wind_m_s=wind_m_s,
        fleet=fleet,
    )
    rows = matrix(flights, tests_by_condition())
    return Evidence(
        schema=SCHEMA,
        fleet=fleet.fleet.name,
        mission=mission,
        vehicles=tuple(fleet.enabled_names),
        wind_m_s=wind_m_s,
        rounds=rounds,
        command=command,
        flights=len(flights),
        wrong_flights=sum(not flight.is_right for flight in flights),
        digest=digest(flights),
        matrix=tuple(rows),
        not_shown=NOT_SHOWN,
        never_seen=tuple(conditions_never_seen(flights)),
        volumes=_rounded(fleet_volumes),
        excursions_m=tuple(_excursion_m(fleet_volumes, flight) for flight in flights),
        provenance=made_by,
    )


def _excursion_m(fleet_volumes: Volumes, flight: FlownCase) -> float:
    """Return the greatest distance of a vehicle's centre outside the flight geography."""
    outside_m = [distance_outside_m(fleet_volumes.geography, point) for point in flight.hull_m]
    return round(max(outside_m, default=0.0), 3)


def _rounded(fleet_volumes: Volumes) -> Volumes:
    values: dict[str, Any] = {}
    for name, value in fleet_volumes._asdict().items():
        if isinstance(value, float):
            values[name] = round(value, 3)
        else:
            values[name] = tuple((round(east, 3), round(north, 3)) for east, north in value)
    return Volumes(**values)


def share_beyond(flights: int) -> float:
    """Return the bound of the share of further flights beyond the contingency volume, 95 %.

    Width and height of the volume are maxima over the same n flights, so that one flight has set
    the width and one the height. The share s of flights that go beyond either is that beyond two
    of n flights: with 95 % confidence it is below the value at which at most one of n flights
    does with a probability of 5 %, that is, (1 - s)^n + n s (1 - s)^(n - 1) = 0.05.
    """
    return upper_bound(1, flights)


def read_evidence(folder: Path) -> Evidence:
    """Return the evidence of a folder.

    Raises:
        ConfigError: there is none, or it cannot be read.
    """
    path = folder / EVIDENCE_NAME
    data = read_bytes(path, EVIDENCE_FILE)
    try:
        evidence = msgspec.json.decode(data, type=Evidence)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{path} is no evidence of this version of Covey: {error}.") from None
    if evidence.schema != SCHEMA:
        raise ConfigError(
            f"{path} has schema {evidence.schema}; this version of Covey reads schema {SCHEMA}."
            " Make that evidence again with this version."
        )
    if not evidence.volumes.geography:
        raise ConfigError(
            f"{path} has a flight geography without corners, so its volumes cannot be compared."
            " Make that evidence again."
        )
    return evidence
