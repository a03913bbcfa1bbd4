"""When a row of the condition table holds: by its fact, its limit, its checks, its time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from onboard.safety.failsafe_table import Condition
from onboard.supervision.condition_monitor import ConditionMonitor, time_limit_s
from onboard.supervision.condition_table import Cause, ConditionRow
from tests.onboard.agent.rig import fleet

S = 1_000_000_000
LIMITS = fleet().fleet
TICK_NS = 20_000_000


def fact(facts: Any) -> Any:
    return facts.value


class Watched:
    """A monitor of one row, or of several of the same fact."""

    def __init__(self, *causes: Cause) -> None:
        conditions = (Condition.BUS_LOST, Condition.BUS_LOST_LONG, Condition.WIND_NEAR)
        rows = [
            ConditionRow(condition, (cause,))
            for condition, cause in zip(conditions, causes, strict=False)
        ]
        self.monitor = ConditionMonitor(LIMITS, rows)

    def holds(self, now_ns: int, value: Any = True, *, slow: bool = False, **more: Any) -> set[str]:
        """Return the names of the conditions that hold at a tick."""
        facts: Any = SimpleNamespace(now_ns=now_ns, value=value, is_slow_tick=slow, **more)
        return {condition.name for condition in self.monitor.update(facts)}


def test_a_fact_holds_if_it_is_true_above_its_limit_or_equal_to_a_value() -> None:
    true = Watched(Cause(fact))
    assert true.holds(S, value=True) == {"BUS_LOST"}
    assert true.holds(2 * S, value=False) == set()

    above = Watched(Cause(fact, above=0.5))
    assert above.holds(S, value=0.5) == set()
    assert above.holds(2 * S, value=0.51) == {"BUS_LOST"}

    equal = Watched(Cause(fact, equals="HOLD"))
    assert equal.holds(S, value="HOLD") == {"BUS_LOST"}
    assert equal.holds(2 * S, value="LAND") == set()


def test_it_counts_after_its_checks_in_a_row() -> None:
    watched = Watched(Cause(fact, checks=3))
    found = [watched.holds(S + tick * TICK_NS) for tick in range(3)]
    assert found == [set(), set(), {"BUS_LOST"}]

    watched.holds(2 * S, value=False)
    assert watched.holds(2 * S + TICK_NS) == set()


def test_one_fact_becomes_a_second_condition_after_a_longer_time() -> None:
    watched = Watched(Cause(fact, over_s=0.5), Cause(fact, over_s="ground_lost_land_s"))
    long_ns = round(LIMITS.ground_lost_land_s * S)
    assert watched.holds(S) == set()
    assert watched.holds(S + S // 2) == set()
    assert watched.holds(S + S // 2 + 1000) == {"BUS_LOST"}
    assert watched.holds(S + long_ns - 1000) == {"BUS_LOST"}
    assert watched.holds(S + long_ns + 1000) == {"BUS_LOST", "BUS_LOST_LONG"}


def test_the_same_fact_with_another_limit_is_another_one() -> None:
    watched = Watched(Cause(fact, above=1.0), Cause(fact, above=2.0), Cause(fact, equals=1.5))
    assert watched.holds(S, value=1.5) == {"BUS_LOST", "WIND_NEAR"}
    assert watched.holds(2 * S, value=2.5) == {"BUS_LOST", "BUS_LOST_LONG"}


def test_what_else_has_to_be_true_is_asked_when_it_has_held() -> None:
    watched = Watched(Cause(fact, given=lambda facts: facts.is_flying))
    assert watched.holds(S, is_flying=False) == set()
    assert watched.holds(S + TICK_NS, is_flying=True) == {"BUS_LOST"}


def test_a_slow_cause_is_looked_at_in_slow_ticks_and_stays_between_them() -> None:
    watched = Watched(Cause(fact, is_slow=True))
    assert watched.holds(S) == set()
    assert watched.holds(S + TICK_NS, slow=True) == {"BUS_LOST"}
    assert watched.holds(S + 2 * TICK_NS, value=False) == {"BUS_LOST"}
    assert watched.holds(S + 6 * TICK_NS, value=False, slow=True) == set()
    assert watched.holds(S + 7 * TICK_NS) == set()


def test_the_detail_is_words_or_what_the_facts_say() -> None:
    rows = (
        ConditionRow(Condition.BUS_LOST, (Cause(fact, detail="no link"),)),
        ConditionRow(Condition.WIND_NEAR, (Cause(fact, detail=lambda facts: f"{facts.now_ns}"),)),
    )
    facts: Any = SimpleNamespace(now_ns=7, value=True, is_slow_tick=False)
    told = ConditionMonitor(LIMITS, rows).update(facts)
    assert told == {Condition.BUS_LOST: "no link", Condition.WIND_NEAR: "7"}


def test_a_cause_without_a_time_counts_at_once() -> None:
    assert time_limit_s(Cause(fact), LIMITS) < 0.0
    assert time_limit_s(Cause(fact, over_s=0.3), LIMITS) == 0.3
    assert time_limit_s(Cause(fact, over_s="ground_lost_land_s"), LIMITS) == (
        LIMITS.ground_lost_land_s
    )
