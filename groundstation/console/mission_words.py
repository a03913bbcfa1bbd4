"""The words of written orders about missions."""

from __future__ import annotations

WORDS = ("mission", "pause", "step", "skip", "continue", "stop")
USAGE = (
    "mission FILE [stepping] [NAME=VALUE ...]; then: pause, step (the next order), "
    "skip (leave it out), continue (all), stop (lands all)"
)
