"""What the agent of a follower knows: which vehicle it follows, and whether that is paused.

The ground sends the follower's goals twice a second, as orders to move that name the followed
vehicle. After the order `pause` the vehicle holds, and such goals are refused until `resume`. After
the order `skip`, it also holds, and such goals are refused until another order comes. A failsafe
that stops the vehicle ends the following in the same way, because the next goal would start it
again.
"""

from __future__ import annotations

from dataclasses import dataclass

from onboard.bus.schema import Order


@dataclass(slots=True)
class FollowFlight:
    """The following of one vehicle."""

    leader: str = ""  # the vehicle that the newest order follows; empty: none
    is_paused: bool = False  # whether an order has paused the following
    is_skipped: bool = False  # whether an order has ended the following
    stopped_by: str = ""  # why a failsafe has ended the following; empty: none has

    @property
    def is_under_way(self) -> bool:
        """Whether the vehicle follows another one, paused or not."""
        return bool(self.leader) and not self.is_skipped and not self.stopped_by

    def begin(self, order: Order) -> None:
        """Remember which vehicle a new order follows, if any."""
        self.leader = order.follows if order.kind == "move" else ""
        self.is_paused = False
        self.is_skipped = False
        self.stopped_by = ""

    def stop(self, cause: str) -> None:
        """End the following because of a failsafe.

        Args:
            cause: reason of the failsafe, in a sentence.
        """
        if self.leader:
            self.stopped_by = cause


def goal_refusal(follow: FollowFlight, order: Order) -> str | None:
    """Return why a goal that the ground sends for following is refused, or None.

    Args:
        follow: present state of the following.
        order: order to move.
    """
    if not order.follows or not follow.leader:
        return None
    if follow.is_skipped:
        return f"It has been ordered to skip the rest of following {follow.leader[:40]}."
    if follow.stopped_by:
        return (
            f"It follows {follow.leader[:40]} no longer ({follow.stopped_by.rstrip('.')}): "
            "order hold before it follows again."
        )
    if follow.is_paused:
        return f"It is paused: `resume` lets it follow {follow.leader[:40]} again."
    return None
