"""Half-planes of the law from a record: against the formula by hand, and against what was flown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from groundstation.cli import main
from groundstation.recording.flight_reading import read_flight
from groundstation.recording.law_rows import RecordedLaw
from groundstation.recording.recorded_flight import Flight
from groundstation.report.payload import payload
from onboard.bus.topics import Topic
from onboard.config.fleet import load_fleet
from tests.groundstation.recorded import FLEET, SECOND
from tests.groundstation.report.made_up import (
    APART_M,
    BEGIN_NS,
    SPEED_M_S,
    Row,
    head_on,
    opened,
    write,
)


def flight_of(folder: Path, told: list[Row]) -> Flight:
    return read_flight(write(folder, told))


def test_the_row_of_two_that_meet_head_on_is_that_of_the_paper_shared_by_two(
    tmp_path: Path,
) -> None:
    fleet = load_fleet(str(FLEET))
    k_1, k_2 = fleet.law.kappa_1_1_s, fleet.law.kappa_2_1_s
    lag_s = fleet.vehicles["mav0"].lag_s
    distance_m = fleet.fleet.safety_distance_m + fleet.law.margin_m(lag_s)
    closing_m_s = 2.0 * SPEED_M_S

    # (17), (20): of e . (a_i - a_j); nobody commands anything, so that each lacks its own half
    needed = (
        -(closing_m_s**2)
        + (k_1 + k_2) * APART_M * closing_m_s
        - 0.5 * k_1 * k_2 * (APART_M**2 - distance_m**2)
    )
    share = 0.5 * needed + fleet.law.shortfall_gain * max(0.0, 0.5 * needed)

    row = RecordedLaw(flight_of(tmp_path, head_on())).row("mav0", 10)

    assert row is not None
    assert row.normal == pytest.approx((-1.0, 0.0))  # away from mav1
    assert row.bound_m_s2 == pytest.approx(share / APART_M, rel=1e-9)


def test_a_report_has_the_half_plane_of_who_is_held_back(tmp_path: Path) -> None:
    flight = flight_of(tmp_path, head_on())
    row = RecordedLaw(flight).row("mav1", 10)
    assert row is not None

    _, curves = opened(payload(flight, made_by="test"))

    assert curves["1/row_direction"][10] == pytest.approx(0.0, abs=0.001)
    assert curves["1/row_bound"][10] == pytest.approx(row.bound_m_s2, abs=0.01)


def test_rows_are_known_only_of_the_law_that_covey_has(tmp_path: Path) -> None:
    assert RecordedLaw(flight_of(tmp_path, head_on(law="off"))).row("mav0", 10) is None
    _, curves = opened(payload(flight_of(tmp_path, head_on(law="mine")), made_by="test"))
    assert not any(key.endswith("row_bound") for key in curves)


def test_a_row_is_left_out_where_the_neighbours_state_is_not_in_the_record(tmp_path: Path) -> None:
    told = [
        row
        for row in head_on()
        if not (row[2] == "mav1" and row[1] is Topic.TICK and row[0] > BEGIN_NS + SECOND // 10)
    ]
    law = RecordedLaw(flight_of(tmp_path, told))

    assert law.row("mav0", 4) is not None
    assert law.row("mav0", 19) is None


@pytest.mark.long
def test_of_a_flight_each_thrust_before_the_law_is_outside_and_each_after_it_inside(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "flight"
    assert main(["fly", "paper", "--lockstep", "--record", str(folder)]) == 0
    flight = read_flight(folder)
    law = RecordedLaw(flight)

    before_m_s2, after_m_s2 = [], []
    for name, vehicle in flight.vehicles.items():
        ticks = vehicle.ticks
        for index in np.flatnonzero((ticks.avoided >= 0.0) & (ticks.slack_m_s2 == 0.0)):
            row = law.row(name, int(index))
            assert row is not None
            before = ticks.thrust_baseline_enu_m_s2[index][:2] @ np.array(row.normal)
            after = ticks.thrust_safe_enu_m_s2[index][:2] @ np.array(row.normal)
            before_m_s2.append(before - row.bound_m_s2)
            after_m_s2.append(after - row.bound_m_s2)

    assert len(before_m_s2) > 100
    assert max(before_m_s2) < 0.01  # without the compensation of drag, which is not recorded
    assert min(after_m_s2) > -1e-9
    assert np.quantile(after_m_s2, 0.05) < 1e-9  # and many on its edge
