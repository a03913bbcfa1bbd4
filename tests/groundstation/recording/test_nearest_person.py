"""How near a vehicle came to a person, by the record."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.recording.flight_report import report
from onboard.config.people import Person
from tests.groundstation.recorded import SECOND
from tests.groundstation.report.made_up import BEGIN_NS, Row, ahead, poses, rows, write

PEOPLE = {"anna": Person(mocap_body="cap3", radius_m=0.5), "ben": Person()}
PLACE = (1.0, -1.5, 1.7)  # beside the way of mav0, which passes it after seven seconds


def stand(begin_s: float, end_s: float, *, is_tracked: bool = True) -> list[Row]:
    """Anna stands at her place and is seen, or not, between these times."""
    return poses("cap3", lambda _: PLACE, begin_s, end_s, is_tracked=is_tracked)


@pytest.mark.parametrize("has_truth", [True, False])
def test_the_distance_is_horizontal_and_to_the_circle(tmp_path: Path, has_truth: bool) -> None:
    folder = write(tmp_path / "flight", [*rows(has_truth=has_truth), *stand(0.0, 10.0)])

    nearest = report(folder, people=PEOPLE).nearest_person
    assert nearest is not None
    assert (nearest.vehicle, nearest.person) == ("mav0", "anna")
    assert nearest.distance_m == pytest.approx(1.0, abs=0.001)
    assert (nearest.stamp_ns - BEGIN_NS) * 1e-9 == pytest.approx(7.0, abs=0.1)


def test_vehicles_of_an_older_record_with_clocks_of_their_own_have_a_distance(
    tmp_path: Path,
) -> None:
    own_clocks = ahead(rows(has_truth=False), "mav0", 2400 * SECOND)
    folder = write(tmp_path / "flight", [*own_clocks, *stand(0.0, 10.0)])

    nearest = report(folder, people=PEOPLE).nearest_person
    assert nearest is not None
    assert nearest.vehicle == "mav0"
    assert nearest.distance_m == pytest.approx(1.0, abs=0.05)


def test_only_the_time_counts_in_which_the_person_is_seen(tmp_path: Path) -> None:
    seen = [*stand(0.0, 3.0), *stand(3.0, 10.0, is_tracked=False)]
    nearest = report(write(tmp_path / "flight", [*rows(), *seen]), people=PEOPLE).nearest_person

    assert nearest is not None
    assert (nearest.stamp_ns - BEGIN_NS) * 1e-9 == pytest.approx(3.0, abs=0.1)


def test_without_persons_there_is_no_distance(tmp_path: Path) -> None:
    lost = stand(0.0, 10.0, is_tracked=False)
    folder = write(tmp_path / "flight", [*rows(), *lost])
    assert report(folder).nearest_person is None
    assert report(folder, people=PEOPLE).nearest_person is None
