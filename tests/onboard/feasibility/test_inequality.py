"""The inequality promises no cell of the map in which vehicles came too near."""

from __future__ import annotations

import pytest

from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility import bounds, inequality
from onboard.feasibility.law_map import MapCell, shipped
from onboard.feasibility.pair_checks import message_age_s
from sitl.monte_carlo import campaign_settings
from sitl.monte_carlo.law_map.cells import Cell, changes

CELLS = shipped().cells


def _holds(cell: MapCell) -> bool:
    flown = Cell(
        errors=cell.errors,
        vehicles=cell.vehicles,
        speed_m_s=cell.speed_m_s,
        delay_ms=1e3 * cell.delay_s,
        loss_pct=1e2 * cell.loss_frac,
    )
    setup = campaign_settings.setup_for(errors=flown.errors, changes=changes(flown))
    fleet = setup.fleet(flown.vehicles)
    finding = inequality.inequality_finding(
        fleet,
        fleet.vehicles[fleet.enabled_names[0]],
        ACCURACIES[cell.errors],
        margin_m=cell.margin_m,
        age_s=message_age_s(fleet),
    )
    return finding.status == "ok"


def test_no_cell_of_the_map_that_it_promises_has_failed() -> None:
    promised = [cell for cell in CELLS if _holds(cell)]
    assert len(promised) >= 5
    assert {cell.vehicles for cell in promised} == {3, 8, 16}
    assert not [str(cell) for cell in promised if cell.has_failed]


@pytest.mark.long
def test_without_what_nobody_knows_yet_it_would_promise_cells_that_have_failed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nothing(braking_m_s2: float, age_s: float) -> float:
        return 0.0 * braking_m_s2 * age_s

    monkeypatch.setattr(inequality, "margin_for_unknown_m", nothing)
    assert [cell for cell in CELLS if _holds(cell) and cell.has_failed]


def test_the_margin_grows_with_speed_and_with_the_square_of_the_time_that_is_unknown() -> None:
    slow_m_s2 = bounds.braking_m_s2(2.5, 0.92, 4.0, 8.0)
    fast_m_s2 = bounds.braking_m_s2(5.0, 0.92, 4.0, 8.0)
    assert inequality.margin_for_unknown_m(slow_m_s2, 0.04) == pytest.approx(0.019, abs=0.001)
    assert inequality.margin_for_unknown_m(fast_m_s2, 0.04) > 0.03

    twice_s = 2.0 * inequality.unknown_s(0.04)
    later = inequality.margin_for_unknown_m(slow_m_s2, 0.04 + 0.5 * twice_s)
    assert later == pytest.approx(4.0 * inequality.margin_for_unknown_m(slow_m_s2, 0.04))
