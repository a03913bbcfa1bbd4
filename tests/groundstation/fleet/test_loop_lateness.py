"""How late a ground's event loop was."""

from __future__ import annotations

from groundstation.fleet.loop_lateness import WINDOW_S, LoopLateness


def test_the_latest_call_of_the_last_seconds_counts() -> None:
    now_ns = 0
    lateness = LoopLateness(lambda: now_ns, period_s=0.02)
    lateness.note_delivery()
    for period_ms in (20, 25, 320, 20, 80):
        now_ns += period_ms * 1_000_000
        lateness.note_delivery()
    assert abs(lateness.worst_s - 0.3) < 1e-9

    now_ns += round((WINDOW_S + 1.0) * 1e9)
    assert lateness.worst_s == 0.0
