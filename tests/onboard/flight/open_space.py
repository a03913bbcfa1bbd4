"""Surroundings without anything in the way."""

from __future__ import annotations

from onboard.avoidance.params import params_of
from onboard.config.law import LawConfig
from onboard.control.router import surroundings

OPEN_SPACE = surroundings((), params_of(LawConfig()))
