"""Campaigns that were never flown, for tests of what is made of them."""

from __future__ import annotations

from typing import Any

import msgspec

from groundstation.evidence.evidence_summary import Evidence, summarized
from groundstation.evidence.kept_flights import FlightCase, FlownCase
from groundstation.evidence.provenance import Provenance
from onboard.config.fleet import FleetConfig

SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0))

PROVENANCE = Provenance(
    versions={"python": "3.11", "covey": "0.1"},
    source="a" * 64,
    machine={"processor": "a <machine>"},
    files={"fleet.toml": "b" * 64},
    config_hash="c" * 16,
    certificates={},
)


def flown(fault: str = "nothing", number: int = 0, **changes: Any) -> FlownCase:
    """A flight over a square of two metres, in which all held."""
    case = FlightCase(fault=fault, round=number, victim="mav0", at_s=9.0, seed=1000 * number)
    one = FlownCase(
        case=case,
        wrong=(),
        seen={},
        took_off=True,
        first_airborne_s=4.0,
        last_airborne_s=20.0,
        smallest_m=0.9,
        smallest_silenced_m=None,
        hull_m=SQUARE,
        highest_m=1.0,
        fastest_m_s=1.0,
        had_pair=True,
    )
    return msgspec.structs.replace(one, **changes)


def evidence(fleet: FleetConfig, flights: list[FlownCase]) -> Evidence:
    """The evidence of such flights."""
    return summarized(
        flights,
        fleet=fleet,
        mission="hop",
        planned=[(0.0, 0.0, 1.0)],
        wind_m_s=4.0,
        rounds=1,
        command="covey evidence fleet.toml hop.toml --wind 4 --out DIR",
        made_by=PROVENANCE,
    )
