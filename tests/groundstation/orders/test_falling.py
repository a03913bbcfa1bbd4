"""Who is below vehicles that are to be killed."""

from __future__ import annotations

from groundstation.fleet.state import FleetState, fold, initial
from groundstation.orders.falling import below_words
from onboard.config.fleet import FleetConfig
from onboard.tuples import Xyz
from tests.groundstation.conftest import telemetry

COLUMN = {"mav0": (0.0, 0.0, 1.0), "mav1": (0.1, 0.0, 2.5), "mav2": (0.0, 0.1, 4.0)}


def at(fleet: FleetConfig, spots: dict[str, Xyz], *, flies: bool = True) -> FleetState:
    state = initial(fleet)
    for name, spot in spots.items():
        message = telemetry(name, state="flying", is_airborne=flies, position_enu_m=spot)
        state = fold(state, message, 0)
    return state


def test_who_kills_the_top_of_a_column_reads_who_is_below(fleet: FleetConfig) -> None:
    state = at(fleet, COLUMN)
    assert below_words(["mav2"], fleet, state, 0) == (
        "mav2 falls on mav1, 1.5 m below; mav2 falls on mav0, 3.0 m below."
    )
    assert below_words(["mav0"], fleet, state, 0) == ""


def test_nobody_is_below_who_flies_aside_or_stands(fleet: FleetConfig) -> None:
    beside = at(fleet, {"mav0": (0.0, 0.0, 1.0), "mav1": (2.0, 0.0, 2.5)})
    assert below_words(["mav1"], fleet, beside, 0) == ""
    standing = at(fleet, COLUMN, flies=False)
    assert below_words(["mav2"], fleet, standing, 0) == ""
    assert below_words(["mav2"], fleet, initial(fleet), 0) == ""
