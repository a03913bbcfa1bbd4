"""Limits of a fleet file for tests of the conditions."""

from __future__ import annotations

from pathlib import Path

from onboard.config.fleet import load_fleet

LIMITS = load_fleet(Path(__file__).parents[3] / "configs/fleets/paper.toml").fleet
