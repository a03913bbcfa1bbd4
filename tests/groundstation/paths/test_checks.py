"""What path checks refuse: jumps between two pieces, and ends in motion."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np
import pytest
from msgspec.structs import replace

from groundstation.paths.checks import path_findings, paths_at_resting, refusals, yaw_finding
from groundstation.paths.pieces import quintic, resting
from onboard.arrays import Array
from onboard.config.fleet import load_fleet
from onboard.control.path import Path, path_of

PAPER = load_fleet(FilePath(__file__).resolve().parents[3] / "configs/fleets/paper.toml")


def motion(x_m: float, y_m: float = -1.2, speed_m_s: float = 0.0) -> Array:
    """Value, first and second derivative of x, y, z and yaw, at a height of one metre."""
    return np.array([[x_m, y_m, 1.0, 0.0], [speed_m_s, 0.0, 0.0, 0.0], [0.0] * 4])


def refused(paths: dict[str, Path]) -> list[str]:
    return refusals(path_findings(PAPER, paths, "step[2]"))


@pytest.mark.parametrize(("jump_m", "is_refused"), [(0.019, False), (0.021, True), (2.5, True)])
def test_a_path_whose_position_jumps_is_refused(jump_m: float, is_refused: bool) -> None:
    here = resting(3.0, motion(-1.2)[0])
    there = resting(3.0, motion(-1.2 + jump_m)[0])

    sentences = refused({"mav0": path_of([here.tolist(), there.tolist()])})

    if is_refused:
        assert len(sentences) == 1
        assert "on mav0's path the position jumps by" in sentences[0]
        assert "at 3.0 s" in sentences[0]
    else:
        assert not sentences


@pytest.mark.parametrize(("jump_m_s", "is_refused"), [(0.049, False), (0.052, True)])
def test_a_path_whose_velocity_jumps_is_refused(jump_m_s: float, is_refused: bool) -> None:
    first = quintic(3.0, motion(-1.2), motion(-0.6, speed_m_s=0.4))
    second = quintic(3.0, motion(-0.6, speed_m_s=0.4 + jump_m_s), motion(0.2))

    sentences = refused({"mav0": path_of([first.tolist(), second.tolist()])})

    if is_refused:
        assert len(sentences) == 1
        assert "the velocity jumps by 0.052 m/s at 3.0 s" in sentences[0]
    else:
        assert not sentences


def test_each_path_must_end_at_rest_also_if_another_one_is_longer() -> None:
    moving = quintic(4.0, motion(-1.2), motion(0.2, speed_m_s=0.6))
    mover = path_of([moving.tolist()])
    longer = path_of([resting(6.0, motion(0.0, y_m=1.2)[0]).tolist()])

    for paths in ({"mav0": mover}, {"mav0": mover, "mav1": longer}):
        sentences = refused(paths)
        assert len(sentences) == 1
        assert "on mav0's path speed at the ends is 0.6 m/s at 4.0 s" in sentences[0]


def test_a_path_over_a_raised_spot_keeps_its_height_above_the_spot() -> None:
    raised = replace(PAPER.vehicles["mav0"], start_enu_m=(-1.2, -1.2, 0.8))
    hill = replace(PAPER, vehicles={**PAPER.vehicles, "mav0": raised})
    paths = {"mav1": path_of([resting(6.0, motion(-1.2)[0]).tolist()])}

    assert not refused(paths)
    (sentence,) = refusals(path_findings(hill, paths, "step[2]"))
    assert "on mav1's path height is 0.2 m" in sentence


@pytest.mark.parametrize(("duration_s", "is_refused"), [(3.0, False), (2.1, True)])
def test_a_heavy_vehicles_path_climbs_with_less_acceleration_than_it_turns(
    duration_s: float, is_refused: bool
) -> None:
    high = motion(-1.2)
    high[0, 2] = 2.0
    climb = quintic(duration_s, motion(-1.2), high)
    across = quintic(duration_s, motion(-1.2), motion(-0.2))

    assert not refused({"mav0": path_of([across.tolist()])})
    sentences = refused({"mav0": path_of([climb.tolist()])})

    assert bool(sentences) is is_refused
    if is_refused:
        assert "path vertical acceleration is 1.31 m/s^2" in sentences[0]


@pytest.mark.parametrize(
    ("turns", "behind_deg"),
    [
        ([(6.0, 180.0)], 0.0),  # a turn from rest to rest as quick as it is flown
        ([(0.1, -358.0)], 0.0),  # from 179 to -179: the heading stays where it is
        ([(0.1, 170.0)], 141.0),  # what it has not turned half a second later
        ([(3.0, 0.0), (0.0, 90.0)], 61.0),  # a jump from one piece to the next
    ],
)
def test_a_path_that_turns_quicker_than_vehicles_is_a_warning(
    turns: list[tuple[float, float]], behind_deg: float
) -> None:
    pieces = []
    here = motion(-1.2)
    for duration_s, turn_deg in [*turns, (3.0, 0.0)]:
        there = here.copy()
        there[0, 3] += np.radians(turn_deg)
        if duration_s > 0.0:
            pieces.append(quintic(duration_s, here, there).tolist())
        here = there
    paths = {
        "mav1": path_of([resting(6.0, motion(0.0)[0]).tolist()]),
        "mav0": path_of(pieces),
    }

    finding = yaw_finding(paths, "step[2]")

    assert finding in path_findings(PAPER, paths, "step[2]")
    if behind_deg == 0.0:
        assert finding.status == "ok"
        assert finding.value < 5.0
    else:
        assert finding.status == "warning"
        assert finding.value == pytest.approx(behind_deg, abs=6.0)
        assert "behind that of mav0's path" in finding.sentence


def test_a_path_to_a_vehicle_that_rests_is_said_at_any_height() -> None:
    over = path_of([quintic(4.0, motion(-1.2), motion(1.2)).tolist()])
    beside = path_of([resting(4.0, motion(-1.2, y_m=1.2)[0]).tolist()])
    paths = {"mav0": over, "mav1": beside}

    assert paths_at_resting(PAPER, paths, {}) == []
    (sentence,) = paths_at_resting(PAPER, paths, {"mav2": (0.0, -1.2, 0.0)})
    assert sentence.startswith("The path of mav0 leads 0.0")
    assert "from mav2, which is on the ground or silent" in sentence
