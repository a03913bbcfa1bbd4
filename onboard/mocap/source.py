"""One interface of all sources of poses: a source calls back with each pose in the fleet's frame.

Callbacks come on a thread of the source and must only hand over. A source judges nothing: a pose that jumps, stands
still or belongs to another body is passed on, and who flies decides (``onboard/localization/pose_validator.py``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from onboard.bus.schema import MocapPose

OnPose = Callable[[MocapPose, int], None]
OnMalformed = Callable[[], None]


class MocapSource(Protocol):
    """Where poses come from; ``on_pose`` gets each with its arrival on this host's monotonic clock [ns]."""

    def start(self) -> None:
        """Begin; the system need not be there yet."""

    def stop(self) -> None:
        """End; no callback comes afterwards. A second call does nothing."""

    @property
    def problem(self) -> str:
        """Why nothing comes, as a sentence; empty when nothing is known to be wrong."""
