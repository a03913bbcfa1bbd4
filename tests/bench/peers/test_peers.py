"""The peers are worth comparing with: each avoids, turns with the world, and solves what it says it
solves.
"""

from dataclasses import replace

import numpy as np
import pytest

from tests.bench.peers.contestants import RING_CHOSEN, RING_GRID, combinations
from tests.bench.peers.encounter import Encounter, into_disc
from tests.bench.peers.methods import METHODS, certificate_rows, in_cell, least_change

AVOIDING = list(METHODS)
D_M = 0.9
TICK_S = 0.02


def encounter(position, velocity, wanted):
    """Everybody (M) sees everybody else, without error."""
    count = len(position)
    others = np.array([[j for j in range(count) if j != i] for i in range(count)])
    return Encounter(
        wanted_m_s2=wanted,
        velocity_m_s=velocity,
        gap_m=position[:, None] - position[others],
        closing_m_s=velocity[:, None] - velocity[others],
        is_on=np.ones(others.shape, bool),
        reach_m_s2=np.full(count, 5.0),
        d_m=np.full(others.shape, D_M),
        speed_m_s=1.25,
        age_s=np.full(others.shape, 0.04),
    )


def fly(name, position, goal, seconds):
    """Point masses that obey at once: smallest distance, final positions."""
    method = METHODS[name]
    velocity = np.zeros_like(position)
    smallest = np.inf
    for _ in range(int(seconds / TICK_S)):
        wish = into_disc(1.0 * (goal - position), np.full(len(goal), 1.0))
        wanted = into_disc(4.0 * (wish - velocity), np.full(len(goal), 3.0))
        a = into_disc(
            method.step(encounter(position, velocity, wanted), method.chosen),
            np.full(len(goal), 5.0),
        )
        position = position + TICK_S * velocity + 0.5 * TICK_S**2 * a
        velocity = velocity + TICK_S * a
        gap = position[:, None] - position[None]
        distance = np.sqrt((gap**2).sum(-1)) + 1e9 * np.eye(len(goal))
        smallest = min(smallest, distance.min())
    return smallest, position


@pytest.mark.long
@pytest.mark.parametrize("name", AVOIDING)
def test_a_peer_brings_a_head_on_pair_past_each_other_when_nothing_errs(name):
    start = np.array([[-2.5, 0.05], [2.5, 0.0]])
    smallest, final = fly(name, start, -start, 30.0)
    # cells know positions only: at this horizon they overshoot into their margin
    assert smallest > (0.80 if name == "cells" else D_M - 0.02)
    np.testing.assert_allclose(final, -start, atol=0.15)


@pytest.mark.parametrize("name", list(METHODS))
def test_a_peer_turns_with_the_world_and_changes_nothing_far_from_everybody(name):
    rng = np.random.default_rng(4)
    position = rng.uniform(-1.2, 1.2, (5, 2))
    velocity = rng.normal(0.0, 0.5, (5, 2))
    wanted = rng.normal(0.0, 1.5, (5, 2))
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    method = METHODS[name]
    plain = into_disc(
        method.step(encounter(position, velocity, wanted), method.chosen), np.full(5, 3.0)
    )
    turned = method.step(
        encounter(position @ turn.T, velocity @ turn.T, wanted @ turn.T), method.chosen
    )
    if not name.endswith("certificate"):  # its thrust limit is a box, as printed
        np.testing.assert_allclose(into_disc(turned, np.full(5, 3.0)), plain @ turn.T, atol=2e-4)
    apart = encounter(100.0 * position, velocity, wanted)
    np.testing.assert_allclose(method.step(apart, method.chosen), wanted, atol=1e-5)


def test_the_certificates_programme_agrees_with_our_projection_for_one_neighbour():
    rng = np.random.default_rng(7)
    values = METHODS["certificate"].chosen
    checked = 0
    for _ in range(500):
        position = np.stack([rng.uniform(-1, 1, 2), np.zeros(2)])
        pair = encounter(position, rng.normal(0.0, 0.7, (2, 2)), rng.normal(0.0, 2.0, (2, 2)))
        normals, bounds = certificate_rows(pair, values)
        lack = bounds[0] - normals[0] @ pair.wanted_m_s2[0]
        foot = pair.wanted_m_s2[0] + np.maximum(0.0, lack) * normals[0, 0]
        if np.abs(foot).max() > 50.0:
            continue
        ours = in_cell(pair.wanted_m_s2[0], normals[0], bounds[0])
        theirs = least_change(pair.wanted_m_s2[0], normals[0], bounds[0], 100.0)
        np.testing.assert_allclose(theirs, ours, atol=1e-7)
        checked += 1
    assert checked > 400


def test_contradictory_certificates_give_a_bounded_thrust():
    normals = np.array([[1.0, 0.0], [-1.0, 0.0]])
    found = least_change(np.zeros(2), normals, np.array([2.0, 1.0]), 5.0)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, [0.5, 0.0], atol=1e-3)


@pytest.mark.parametrize("name", list(METHODS))
def test_a_peer_survives_coincident_vehicles_and_nobody_at_all(name):
    method = METHODS[name]
    close = encounter(np.zeros((3, 2)), np.zeros((3, 2)), np.ones((3, 2)))
    assert np.isfinite(method.step(close, method.chosen)).all()
    alone = replace(close, is_on=np.zeros((3, 2), bool))
    np.testing.assert_allclose(method.step(alone, method.chosen), np.ones((3, 2)), atol=1e-6)


def test_every_method_has_the_same_tuning_budget_and_a_choice_from_its_grid():
    grids = {name: (method.grid, method.chosen) for name, method in METHODS.items()}
    for grid, chosen in [*grids.values(), (RING_GRID, RING_CHOSEN)]:
        assert len(combinations(grid)) == 6
        assert dict(chosen) in combinations(grid)
