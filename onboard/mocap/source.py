"""The interface of all sources of poses: a source calls back with each pose in the fleet's frame.

Callbacks come on a thread of the source, so they must only hand the pose over to another thread. A
source does not check poses: it also passes on one that jumps, stands still or belongs to another
body, and the agent decides (``onboard/localization/pose_validator.py``).
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
        """Start; the system need not be there yet."""

    def stop(self) -> None:
        """Stop; no callback comes afterwards. A second call does nothing."""

    @property
    def problem(self) -> str:
        """Sentence that says why no poses come; empty if nothing is known to be wrong."""
