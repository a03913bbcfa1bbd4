"""Writes the folder of evidence: GeoJSON, picture, page and ``evidence.json``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from groundstation.evidence.evidence_comparison import Agreement, compared
from groundstation.evidence.evidence_page import PAGE_NAME, page
from groundstation.evidence.evidence_summary import EVIDENCE_NAME, Evidence
from groundstation.evidence.kept_flights import FlownCase
from groundstation.evidence.volume_drawing import DRAWING_NAME, draw_volumes
from groundstation.evidence.volumes import geojson
from onboard.config.fleet import FleetConfig

GEOGRAPHY_NAME = "geography.geojson"


class OtherMachine(NamedTuple):
    """The evidence of another machine, with its flights."""

    evidence: Evidence
    flights: Sequence[FlownCase]


def write_folder(
    folder: Path,
    evidence: Evidence,
    *,
    fleet: FleetConfig,
    flights: Sequence[FlownCase],
    other: OtherMachine | None = None,
) -> list[Agreement]:
    """Write all files of the evidence.

    Args:
        folder: an existing folder.
        evidence: the evidence of a campaign.
        fleet: the fleet that was flown.
        flights: the flights of the campaign, for the picture.
        other: evidence of another machine, with which the figures are compared; or None.

    Returns:
        The compared figures; empty without other evidence.

    Raises:
        OSError: a file cannot be written.
    """
    shapes = geojson(evidence.volumes, fleet)
    encoded_shapes = msgspec.json.format(msgspec.json.encode(shapes), indent=1)
    (folder / GEOGRAPHY_NAME).write_bytes(encoded_shapes + b"\n")

    title = f"{evidence.fleet}, {evidence.mission}, {evidence.wind_m_s:g} m/s of wind"
    drawing = folder / DRAWING_NAME
    draw_volumes(drawing, title, evidence.volumes, fleet, [flight.hull_m for flight in flights])

    agreements: list[Agreement] = []
    other_machine = ""
    if other is not None:
        half_body_m = 0.5 * fleet.fleet.body_diameter_m
        agreements = compared(
            evidence,
            other.evidence,
            flights_here=flights,
            flights_there=other.flights,
            half_body_m=half_body_m,
        )
        made_by = other.evidence.provenance
        versions = [f"{name} {version}" for name, version in made_by.versions.items()]
        other_machine = ", ".join([*made_by.machine.values(), *versions])

    text = page(evidence, drawing.read_bytes(), agreements, other_machine)
    (folder / PAGE_NAME).write_text(text, encoding="utf-8")
    encoded_evidence = msgspec.json.format(msgspec.json.encode(evidence), indent=1)
    (folder / EVIDENCE_NAME).write_bytes(encoded_evidence + b"\n")
    return agreements
