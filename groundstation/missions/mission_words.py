"""The words of written orders about missions."""

from __future__ import annotations

WORDS = ("mission", "pause", "step", "skip", "continue", "stop")
USAGE = (
    "mission FILE [at TIME] [stepping] [NAME=VALUE ...]; then: pause, step (the next order), "
    "skip (leave it out), continue (all), stop (lands all)"
)


def are_of_mission(words: list[str]) -> bool:
    """Whether a line is an order about a mission; ``pause all`` is an order to vehicles."""
    if words[0] == "mission":
        return True
    return words[0] in WORDS and len(words) == 1
