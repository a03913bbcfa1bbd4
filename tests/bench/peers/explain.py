"""Pictures for docs/law.md, each made by flying or computing what it shows: ``make bench-law
ARGS=--explain``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from onboard.avoidance.constraints import distance_row
from onboard.avoidance.pairs import NeighbourPair
from onboard.avoidance.params import params_of
from onboard.config.fleet import load_fleet
from onboard.config.law import LawConfig
from onboard.vectors import ZERO_XY, Vec2
from sitl.monte_carlo import scenarios
from tests.bench.peers import arena, ideal_ring, pictures
from tests.bench.peers.ablation import VARIANTS
from tests.bench.peers.contestants import COVEY, PEERS, Contestant
from tests.bench.peers.encounter import Array, length
from tests.onboard.avoidance.law_cases import nearest_thrust

_FLEET = Path(__file__).parents[3] / "configs/fleets/paper.toml"
WEAK = "ardrone"
_TOP_SPEED_SEEDS = range(1000, 1020)
# nothing errs: only the vehicle's own lag and limits are left
_STILL = ("delay_s=0", "loss_share=0", "gust_m_s2=0", "lag_mismatch=0", "gain=0")
_UNDISTURBED: dict[str, Any] = {
    "errors": "none",
    "sets": (*_STILL, "sitl.static_gain=1", "sitl.tilt_bias_deg=0"),
    "types": WEAK,
}


def draw(folder: Path) -> list[Path]:
    """Draw all of them into ``folder``; returns their paths."""
    drawn = {
        "law_half_planes.png": half_planes,
        "law_ring.png": ring,
        "law_lag.png": lag,
        "law_turn.png": turn,
        "law_top_speed.png": top_speed,
    }
    paths = []
    for name, picture in drawn.items():
        paths.append(folder / name)
        picture(paths[-1])
    return paths


def half_planes(path: Path) -> None:
    """One tick in which a vehicle is asked to fly between two neighbours that come nearer."""
    params = params_of(LawConfig())
    d = params.spacing.safety_distance_m + params.spacing.margin_m
    gaps = (Vec2(-1.15, -0.50), Vec2(-0.15, 1.10))  # own minus neighbour's
    closing = (Vec2(0.50, 0.25), Vec2(0.20, -0.30))
    rows = [
        distance_row(
            NeighbourPair(
                e=e,
                w=w,
                command_m_s2=ZERO_XY,
                intent_m_s=w,
                d_m=d,
                distance_2_m2=0.0,
                crowd_count=0.0,
                is_near=True,
                is_cooperative=True,
                table_index=0,
            ),
            d,
            params,
        )
        for e, w in zip(gaps, closing, strict=True)
    ]
    radius = 4.5
    wanted = Vec2(3.5, -1.9)
    found = np.array(nearest_thrust(wanted, rows, radius).point)
    normals = np.array([row.normal for row in rows])
    bounds = np.array([row.bound_m_s2 for row in rows])
    names = ["forbidden by neighbour 1", "forbidden by neighbour 2"]
    pictures.half_planes(np.array(wanted), found, normals, bounds, names, radius, path)


def nearest(track: tuple[Array, Array]) -> tuple[Array, Array]:
    """Time, and the smallest distance of any pair at that time."""
    t_s, positions = track
    first, second = np.triu_indices(positions.shape[1], 1)
    return t_s, length((positions[:, first] - positions[:, second])[..., :2]).min(-1)


def ring(path: Path) -> None:
    """The paper's ring where its assumptions hold, and on vehicles that have to tilt first."""
    t_s, positions, _ = ideal_ring.fly(load_fleet(_FLEET), (0, 1, 2))
    printed = replace(PEERS["ring"], change=COVEY.change)
    curves = {
        "as in the proof: no lag, no error": nearest((t_s, positions)),
        "nothing errs, but the drone has to tilt": nearest(
            arena.trace(printed, "form3", 0, **_UNDISTURBED)
        ),
        "everything errs a little": nearest(arena.trace(printed, "form3", 0, types=WEAK)),
    }
    pictures.histories(
        curves, path, "The paper's ring, three vehicles into a triangle", {"0.80 m": 0.8}, 14.0
    )


def lag(path: Path) -> None:
    """Two vehicles that change places, with and without prediction over the own lag."""
    variants: Sequence[tuple[str, Contestant]] = [
        ("Covey", COVEY),
        ("no prediction", VARIANTS["no-prediction"]),
        ("no avoidance", PEERS["off"]),
    ]
    curves = {
        name: nearest(arena.trace(contestant, "swap8", 3, types=WEAK))
        for name, contestant in variants
    }
    title = "Eight weak vehicles change places: smallest distance of all pairs"
    pictures.histories(curves, path, title, {"0.80 m": 0.8}, 20.0)


def turn(path: Path) -> None:
    """Exact swaps, where nobody has a reason to prefer a side."""
    variants = {
        "no rotation rows": VARIANTS["no-rotation"],
        "own direction only": VARIANTS["pair"],
        "Covey": COVEY,
    }
    traces = {
        f"{name}, {scenario[4:-1]} vehicles": arena.trace(contestant, scenario, 1)[1]
        for scenario in ("swap2x", "swap8x")
        for name, contestant in variants.items()
    }
    pictures.paths(traces, path, "Who turns about whom", columns=3)


def top_speed(path: Path) -> None:
    """The fastest vehicle of each flight of the mix, with and without the limit of the speed."""
    speeds_m_s: dict[str, list[float]] = {}
    for contestant in (VARIANTS["no-speed"], COVEY):
        speeds_m_s[contestant.title] = [
            outcome.max_speed_m_s
            for scenario in scenarios.MIX
            for outcome in arena.fly(contestant, scenario, _TOP_SPEED_SEEDS).outcomes
        ]
    pictures.histogram(
        speeds_m_s,
        path,
        title="The fastest vehicle of each flight; max_speed_m_s is 1.0",
        axis_title="its greatest horizontal speed in m/s",
    )
