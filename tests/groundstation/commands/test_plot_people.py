"""Persons in the plan of a flight."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Circle

from groundstation.cli import main
from groundstation.figures import plan_figure
from groundstation.figures.data import POSES, TOPICS, from_samples
from onboard.config.people import Person
from tests.groundstation.recorded import FLEET, read
from tests.groundstation.report.made_up import poses, rows, write

PEOPLE = {"anna": Person(mocap_body="cap3", radius_m=0.5), "ben": Person()}


def walk(time_s: float) -> tuple[float, float, float]:
    """Where anna's markers are."""
    return (0.5 * time_s - 2.0, -2.0, 1.7)


def test_a_person_is_a_walk_with_a_circle_where_he_was_when_two_vehicles_were_closest(
    tmp_path: Path,
) -> None:
    lost = poses("cap3", lambda _: (9.0, 9.0, 9.0), 8.0, 10.0, is_tracked=False)
    told = [*rows(), *poses("cap3", walk, 0.0, 8.0), *lost]
    samples = read(write(tmp_path / "flight", told), (*TOPICS, POSES))
    flight = from_samples(samples, title="test", safety_distance_m=0.8, people=PEOPLE)

    assert flight is not None
    [anna] = flight.walks  # ben was never seen
    assert anna.position_at(10.0) == pytest.approx(walk(8.0), abs=0.02)
    assert flight.closest() is not None

    [axes] = plan_figure.draw(flight).axes
    [circle] = [one for one in axes.patches if isinstance(one, Circle) and one.radius == 0.5]
    assert circle.center == pytest.approx(walk(5.0)[:2], abs=0.05)  # mav0 passes mav1 at 5 s
    lines = [line.get_xydata() for line in axes.lines]
    walked_m = anna.position_enu_m[:, :2]
    assert any(np.array_equal(line, walked_m, equal_nan=True) for line in lines)
    assert "anna" in {text.get_text() for text in axes.texts}


@pytest.mark.parametrize("is_recorded", [True, False], ids=["not tracked", "gap of the record"])
def test_the_line_of_a_person_crosses_no_time_in_which_nobody_saw_the_person(
    tmp_path: Path, is_recorded: bool
) -> None:
    told = [*rows(), *poses("cap3", walk, 0.0, 3.0), *poses("cap3", walk, 6.0, 8.0)]
    if is_recorded:
        told += poses("cap3", walk, 3.0, 6.0, is_tracked=False)
    samples = read(write(tmp_path / "flight", told), (*TOPICS, POSES))
    flight = from_samples(samples, title="test", safety_distance_m=0.8, people=PEOPLE)

    assert flight is not None
    [anna] = flight.walks
    steps_m = np.linalg.norm(np.diff(anna.position_enu_m, axis=0), axis=-1)
    assert np.nanmax(steps_m) < 0.1
    assert np.isfinite(steps_m).sum() > 50
    assert anna.position_at(4.5) == pytest.approx(walk(3.0), abs=0.1), "last seen there"


def test_the_command_takes_the_persons_from_the_fleet_file(tmp_path: Path) -> None:
    people = "\n[people.anna]\nmocap_body = 'cap3'\n"
    folder = write(
        tmp_path / "flight",
        [*rows(), *poses("cap3", walk, 0.0, 8.0)],
        fleet=FLEET.read_text(encoding="utf-8") + people,
    )
    assert main(["plot", str(folder)]) == 0
    assert (folder / "figures/fig4_plan.svg").read_text(encoding="utf-8").count("anna") > 0
