"""Following another vehicle, as its own agent knows it: whom, and whether that is paused.

The goals of a follower come from the ground, twice a second, and each names the vehicle that is
followed. A pause holds the vehicle where it is: goals of that kind are refused until `resume`. To
skip the rest ends the following here; goals of that kind are refused until another order comes.
"""

from __future__ import annotations

from dataclasses import dataclass

from onboard.bus.schema import Order


@dataclass(slots=True)
class FollowFlight:
    """The following of one vehicle."""

    leader: str = ""  # the vehicle that the newest order follows; empty: it follows nobody
    is_paused: bool = False  # an order has it hold where it is
    is_skipped: bool = False  # an order has ended it here

    @property
    def is_under_way(self) -> bool:
        """Whether the vehicle follows another one, paused or not."""
        return bool(self.leader) and not self.is_skipped

    def begin(self, order: Order) -> None:
        """Take note of an order that begins: whom it follows, if anybody."""
        self.leader = order.follows if order.kind == "move" else ""
        self.is_paused = False
        self.is_skipped = False


def goal_refusal(follow: FollowFlight, order: Order) -> str | None:
    """Return the reason why a goal of the vehicle that is followed is not taken; or None.

    Args:
        follow: as it is now.
        order: to move.
    """
    if not order.follows or not follow.leader:
        return None
    if follow.is_skipped:
        return f"It has been ordered to skip the rest of following {follow.leader[:40]}."
    if follow.is_paused:
        return f"It is paused: `resume` lets it follow {follow.leader[:40]} again."
    return None
