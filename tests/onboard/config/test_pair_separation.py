"""The one number that says how far a pair is apart."""

import re

import numpy as np
import pytest

from onboard.config.fleet import load_fleet
from onboard.config.pair_separation import separation_m, separations_m
from onboard.feasibility.fleet_checks import spot_findings


def test_the_number_is_below_the_safety_distance_where_neither_distance_nor_height_separates():
    limits = load_fleet("configs/fleets/above.toml").fleet
    assert limits.vertical_separation_m is not None
    rng = np.random.default_rng(1)
    offsets = rng.uniform(-2.0, 2.0, (500, 3))
    found = separations_m(offsets, limits.height_share)
    beside = np.hypot(offsets[:, 0], offsets[:, 1])
    above = abs(offsets[:, 2])
    is_apart = (beside >= limits.safety_distance_m) | (above >= limits.vertical_separation_m)
    assert ((found >= limits.safety_distance_m) == is_apart).all()
    each = [
        separation_m(offset, (0.0, 0.0, 0.0), limits.height_share) for offset in offsets.tolist()
    ]
    assert each == pytest.approx(found)
    assert separations_m(offsets, 0.0).tolist() == beside.tolist()


@pytest.mark.parametrize(("errors", "is_refused"), [("mocap", False), ("gps", True)])
def test_spots_above_each_other_are_judged_by_the_accuracy_of_heights(errors, is_refused):
    fleet = load_fleet("configs/fleets/above.toml")
    spots = {"mav0": (0.0, 0.0, 1.0), "mav1": (0.0, 0.0, 2.52)}
    worst = {
        finding.title: finding for finding in spot_findings(fleet, spots, "slots", errors=errors)
    }["spacing, slots"]
    assert (worst.status == "refused") is is_refused


@pytest.mark.parametrize("errors", ["mocap", "vision", "gps"])
def test_a_refusal_names_a_height_that_suffices(errors):
    fleet = load_fleet("configs/fleets/above.toml")

    def spacing(height_m):
        spots = {"mav0": (0.0, 0.0, 1.0), "mav1": (0.0, 0.0, 1.0 + height_m)}
        findings = spot_findings(fleet, spots, "slots", errors=errors)
        return next(finding for finding in findings if finding.title == "spacing, slots")

    refusal = spacing(1.2)
    assert refusal.status == "refused"
    named = re.search(r"or ([\d.]+) m above each other", refusal.sentence)
    assert named is not None

    height_m = float(named[1])
    assert spacing(height_m).status == "ok"
    assert spacing(height_m - 0.02).status == "refused"


def test_spots_above_each_other_are_refused_without_a_vertical_separation():
    spots = {"mav0": (0.0, 0.0, 1.0), "mav1": (0.0, 0.0, 2.52)}
    cylinders = load_fleet("configs/fleets/sih.toml")
    assert {one.title: one for one in spot_findings(cylinders, spots, "slots")}[
        "spacing, slots"
    ].status == "refused"
