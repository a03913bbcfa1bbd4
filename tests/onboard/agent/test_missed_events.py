"""Ends of orders and critical events are told again to a ground that was cut off, whatever happened
meanwhile.
"""

from __future__ import annotations

from onboard.agent.missed_events import MissedEvents
from onboard.agent_commands import Command, Publish
from onboard.bus.schema import Event, Severity
from onboard.bus.topics import Topic

S = 1_000_000_000


def _end(at_s: float, order_id: str = "o1", severity: str = "info") -> Publish:
    stamp_ns = round(at_s * S)
    event = Event(
        vehicle="mav0", stamp_ns=stamp_ns, severity=severity, code="order-ended", sentence="Done.",  # type: ignore[arg-type]
        order_id=order_id, order_outcome="done",
    )  # fmt: skip
    return Publish(Topic.EVENT, event)


def _event(at_s: float, severity: Severity) -> Publish:
    event = Event(
        vehicle="mav0", stamp_ns=round(at_s * S), severity=severity, code="x", sentence="PX4 lands."
    )
    return Publish(Topic.EVENT, event)


def _told(events: MissedEvents, at_s: float) -> list[Command]:
    return events.pass_on([], round(at_s * S))


def test_an_end_within_the_cut_is_told_again_a_second_after_the_ground_is_back() -> None:
    events = MissedEvents()
    before = _end(5.0, "o0")
    within = _end(12.0)
    for one in (before, within):
        assert isinstance(one.message, Event)
        assert events.pass_on([one], one.message.stamp_ns) == [one]
    events.see("ground-1", False, 10 * S)
    events.see("ground-1", True, 20 * S)
    assert not _told(events, 20.9)
    assert _told(events, 21.1) == [within]
    assert not _told(events, 22.0)


def test_a_ground_that_is_lost_again_before_it_was_told_hears_all_of_it_later() -> None:
    events = MissedEvents()
    within = _end(12.0)
    events.pass_on([within], 12 * S)
    events.see("ground-1", False, 10 * S)
    events.see("ground-1", True, 20 * S)
    events.see("ground-1", False, 20 * S + S // 2)
    _told(events, 21.1)
    events.see("ground-1", True, 30 * S)
    assert _told(events, 31.1) == [within]


def test_parts_of_a_path_push_no_end_out() -> None:
    events = MissedEvents()
    within = _end(12.0)
    events.pass_on(
        [within, *(_end(12.0 + 0.01 * part, f"part {part}", "debug") for part in range(20))], 13 * S
    )
    events.see("ground-1", False, 10 * S)
    events.see("ground-1", True, 20 * S)
    assert _told(events, 21.1) == [within]


def test_why_a_vehicle_landed_is_told_again_with_the_end_of_its_order() -> None:
    events = MissedEvents()
    critical = _event(12.0, "critical")
    end = _end(12.0)
    events.pass_on([_event(11.9, "warning"), critical, end], 12 * S)
    events.see("ground-1", False, 10 * S)
    events.see("ground-1", True, 20 * S)
    assert _told(events, 21.1) == [critical, end]


def test_critical_events_push_no_end_out() -> None:
    events = MissedEvents()
    within = _end(12.0)
    events.pass_on([within, *(_event(12.0 + 0.01 * n, "critical") for n in range(100))], 13 * S)
    events.see("ground-1", False, 10 * S)
    events.see("ground-1", True, 20 * S)
    assert within in _told(events, 21.1)


def test_an_event_is_told_again_if_the_loss_of_the_ground_was_noticed_late() -> None:
    events = MissedEvents()
    before = _end(6.9, "o0")
    within = _end(7.1)
    events.pass_on([before, within], 8 * S)
    events.see("ground-1", False, 10 * S)
    events.see("ground-1", True, 20 * S)
    assert _told(events, 21.1) == [within]
