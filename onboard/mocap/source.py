"""The interface of all sources of poses. A source calls back with each pose in the fleet frame.

A source calls back on its own thread, so a callback must only hand the pose over to another thread.
A source does not check poses. It also passes on wrong ones, and the agent decides
(``onboard/localization/pose_validator.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from onboard.bus.schema import MocapPose

OnPose = Callable[[MocapPose, int], None]  # pose, its arrival on this host's monotonic clock [ns]
OnMalformed = Callable[[], None]


class MocapSource(Protocol):
    """A source of poses."""

    def start(self) -> None:
        """Start; the motion-capture system may start later."""

    def stop(self) -> None:
        """Stop. No callback follows. A second call does nothing."""

    @property
    def problem(self) -> str:
        """Sentence that says why no poses arrive; empty if no problem is known."""
