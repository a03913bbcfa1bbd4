"""The paper's own flight: what its Proposition 1 promises holds where its assumptions do."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from onboard.config import load_fleet
from tests.peers import ideal_ring

ROOT = Path(__file__).parents[2]
FLEET = load_fleet(ROOT / "configs/fleets/paper.toml")


@pytest.mark.parametrize("order", itertools.permutations(range(3)))
def test_the_papers_ring_keeps_h_positive_for_every_pair_when_nothing_errs_or_lags(order):
    _, positions, gaps = ideal_ring.fly(FLEET, order)
    assert (gaps**2 - 0.8**2).min() >= 0.0
    _, slots = ideal_ring.starts_and_slots(FLEET)
    np.testing.assert_allclose(positions[-1], slots[list(order)], atol=0.01)


def test_the_ring_of_the_paper_really_has_to_act():
    _, _, gaps = ideal_ring.fly(FLEET, (0, 1, 2))
    assert gaps.min() < 0.82
