"""Paths in whole flights: three vehicles, from files to the verdict, and what happens when one does
not go along.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from groundstation.mission_files.loading import mission_from_mapping
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.mission_findings import mission_findings
from onboard.config.fleet import FleetConfig
from sitl.lockstep.flight import Lockstep

SECONDS = 5.0


def files(
    folder: Path, fleet: FleetConfig, metres: float = 1.0, seconds: float = SECONDS
) -> dict[str, str]:
    """Each vehicle northwards from its take-off spot, side by side."""
    out = {}
    for name in fleet.enabled_names:
        x, y, _ = fleet.vehicles[name].start_enu_m
        share = np.linspace(0.0, 1.0, 51)
        eased = share**3 * (10 - 15 * share + 6 * share**2)
        lines = [
            f"{seconds * s:.3f},{x},{y + metres * e:.4f},1.0"
            for s, e in zip(share, eased, strict=True)
        ]
        (folder / f"{name}.csv").write_text("t,x,y,z\n" + "\n".join(lines), encoding="utf-8")
        out[name] = f"{name}.csv"
    return out


def show(folder: Path, fleet: FleetConfig, paths: dict[str, str], **step: object) -> Mission:
    """Up, along the paths, and down."""
    steps = [{"do": "takeoff"}, {"do": "follow_path", "paths": paths, **step}, {"do": "land"}]
    expect = {"min_separation_m": 0.8, "arrived_within_m": 0.2, "all_landed": True}
    data = {"schema": 1, "step": steps, "expect": expect}
    return mission_from_mapping(data, path=str(folder / "show.toml"), fleet=fleet)


@pytest.mark.long
def test_three_vehicles_follow_their_paths_together(
    lockstep: Callable[..., Lockstep], paper: FleetConfig, tmp_path: Path
) -> None:
    lags: list[float] = []
    flight = lockstep(paper)
    flight.client.add_listener(
        lambda state: lags.extend(
            v.telemetry.path_lag_m for v in state.vehicles.values() if v.telemetry
        )
    )
    mission = show(tmp_path, paper, files(tmp_path, paper))
    assert not [finding for finding in mission_findings(mission) if finding.status == "refused"]
    verdict = flight.fly(mission)
    assert verdict.passed, verdict.sentences
    assert 0.0 < max(lags) < 0.3


@pytest.mark.long
def test_nobody_starts_when_one_does_not_take_its_path(
    lockstep: Callable[..., Lockstep], paper: FleetConfig, tmp_path: Path
) -> None:
    # the ground lets a simulation try paths of another law; the vehicles do not
    fleet = paper.with_law("paper")
    flight = lockstep(fleet)
    paths = files(tmp_path, paper)
    mission = show(
        tmp_path,
        fleet,
        {**paths, **dict.fromkeys(["mav2"], files(tmp_path, paper, 30.0, 60.0)["mav2"])},
    )
    verdict = flight.fly(mission)
    assert not verdict.passed
    assert "geofence" in verdict.summary
    assert all(verdict.landed.values())
    assert not [event for event in flight.events if event.code == "order-follow_path"]


@pytest.mark.long
def test_the_others_wait_for_one_that_falls_behind_until_a_hovering_one_has_stepped_aside(
    lockstep: Callable[..., Lockstep], paper: FleetConfig, tmp_path: Path
) -> None:
    flight = lockstep(paper)
    rates: list[float] = []
    flight.client.add_listener(
        lambda state: rates.extend(
            v.telemetry.path_rate_frac for v in state.vehicles.values() if v.telemetry
        )
    )
    paths = files(tmp_path, paper)
    blocked = (tmp_path / "mav1.csv").read_text(encoding="utf-8").splitlines()
    times_s = [float(line.split(",")[0]) for line in blocked[1:]]
    # past where mav2 hovers, so that mav1 stays more than BEHIND_M behind; their goals are nearer
    # than the distance to keep, so mav2 steps aside for it after a while
    east = [f"{t},{1.6 * (t / SECONDS) ** 2 * (3 - 2 * t / SECONDS)},-1.5,1" for t in times_s]
    (tmp_path / "mav1.csv").write_text("t,x,y,z\n" + "\n".join(east), encoding="utf-8")
    verdict = flight.fly(show(tmp_path, paper, {name: paths[name] for name in ("mav0", "mav1")}))
    assert min(rates) == 0.5
    follow = next(step for step in verdict.steps if step.step.startswith("follow_path"))
    assert follow.vehicles == {"mav0": "done", "mav1": "done"}
    assert flight.min_separation_m > 0.8
    assert all(verdict.landed.values())
