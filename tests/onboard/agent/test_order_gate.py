"""Signed orders that are not new: kept for later, for another flight, or sent twice."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from onboard.agent.order_gate import FRESH_EMERGENCY_S, FRESH_S, OrderGate
from onboard.bus.protocol import UntrustedOrder
from onboard.bus.schema import Order

NOW_NS = 1_000_000_000_000
MOVE = Order(
    order_id="g-1",
    author="ann",
    kind="move",
    stamp_ns=NOW_NS,
    deadline_ns=NOW_NS + 1,
    heard_boot_id=7,
    heard_ns=NOW_NS,
)


def _code(found: UntrustedOrder | None) -> str | None:
    return None if found is None else found.code


def test_a_new_order_passes_once() -> None:
    gate = OrderGate(boot_id=7)
    assert gate.refusal(MOVE, NOW_NS) is None
    assert _code(gate.refusal(MOVE, NOW_NS)) == "replayed"
    assert gate.refusal(replace(MOVE, order_id="g-2"), NOW_NS) is None


@pytest.mark.parametrize("kind", ["move", "kill"])
def test_an_order_is_for_one_start_of_the_agent(kind: str) -> None:
    gate = OrderGate(boot_id=8)  # as after a restart, which forgets what was received
    order = replace(MOVE, kind=kind)
    assert _code(gate.refusal(order, NOW_NS)) == "other start"
    assert _code(gate.refusal(replace(order, heard_boot_id=0, heard_ns=0), NOW_NS)) == "other start"


@pytest.mark.parametrize(
    ("kind", "limit_s"),
    [("move", FRESH_S), ("kill", FRESH_EMERGENCY_S), ("land", FRESH_EMERGENCY_S)],
)
def test_an_order_that_was_held_back_is_late_whatever_the_senders_clock_says(
    kind: str, limit_s: float
) -> None:
    order = replace(MOVE, kind=kind, deadline_ns=0)
    for later_s, code in ((limit_s - 0.1, None), (limit_s + 0.1, "late"), (-0.1, "late")):
        assert _code(OrderGate(boot_id=7).refusal(order, NOW_NS + round(later_s * 1e9))) == code


def test_a_deadline_that_has_passed_refuses_all_but_a_kill() -> None:
    late_ns = NOW_NS + 2_000_000_000
    assert _code(OrderGate(boot_id=7).refusal(MOVE, late_ns)) == "late"
    assert OrderGate(boot_id=7).refusal(replace(MOVE, kind="kill"), late_ns) is None


def test_no_order_can_be_sent_twice_after_many_others() -> None:
    gate = OrderGate(boot_id=7)
    kill = replace(MOVE, kind="kill", deadline_ns=0)
    assert gate.refusal(kill, NOW_NS) is None
    for count in range(2000):
        assert (
            gate.refusal(replace(kill, order_id=f"g-1-{count}"), NOW_NS + count * 10_000_000)
            is None
        )
    codes = {
        _code(gate.refusal(kill, NOW_NS + round(at_s * 1e9))) for at_s in (20.0, 29.9, 30.1, 60.0)
    }
    assert codes == {"replayed", "late"}
