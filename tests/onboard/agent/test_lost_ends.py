"""Ends of orders are told again to a ground that was cut off, whatever happened meanwhile."""

from __future__ import annotations

from onboard.agent.lost_ends import LostEnds
from onboard.agent_commands import Command, Publish
from onboard.bus.schema import Event
from onboard.bus.topics import Topic

S = 1_000_000_000


def _end(at_s: float, order_id: str = "o1", severity: str = "info") -> Publish:
    stamp_ns = round(at_s * S)
    event = Event(
        vehicle="mav0", stamp_ns=stamp_ns, severity=severity, code="order-ended", sentence="Done.",  # type: ignore[arg-type]
        order_id=order_id, order_outcome="done",
    )  # fmt: skip
    return Publish(Topic.EVENT, event)


def _told(ends: LostEnds, at_s: float) -> list[Command]:
    return ends.pass_on([], round(at_s * S))


def test_an_end_within_the_cut_is_told_again_a_second_after_the_ground_is_back() -> None:
    ends = LostEnds()
    before = _end(5.0, "o0")
    within = _end(12.0)
    for one in (before, within):
        assert isinstance(one.message, Event)
        assert ends.pass_on([one], one.message.stamp_ns) == [one]
    ends.see("ground-1", False, 10 * S)
    ends.see("ground-1", True, 20 * S)
    assert not _told(ends, 20.9)
    assert _told(ends, 21.1) == [within]
    assert not _told(ends, 22.0)


def test_a_ground_that_is_lost_again_before_it_was_told_hears_all_of_it_later() -> None:
    ends = LostEnds()
    within = _end(12.0)
    ends.pass_on([within], 12 * S)
    ends.see("ground-1", False, 10 * S)
    ends.see("ground-1", True, 20 * S)
    ends.see("ground-1", False, 20 * S + S // 2)
    _told(ends, 21.1)
    ends.see("ground-1", True, 30 * S)
    assert _told(ends, 31.1) == [within]


def test_parts_of_a_path_push_no_end_out() -> None:
    ends = LostEnds()
    within = _end(12.0)
    ends.pass_on(
        [within, *(_end(12.0 + 0.01 * part, f"part {part}", "debug") for part in range(20))], 13 * S
    )
    ends.see("ground-1", False, 10 * S)
    ends.see("ground-1", True, 20 * S)
    assert _told(ends, 21.1) == [within]
