"""What the failsafe supervisor tells of conditions, and when, tick by tick."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from onboard.agent.core import AgentCore
from onboard.safety.failsafe_table import Action, Condition, Situation
from onboard.supervision.failsafe_supervisor import FailsafeDecision
from tests.onboard.agent.rig import fleet

S = 1_000_000_000


def _supervisor() -> Any:
    return AgentCore(fleet(), "mav0", boot_id=1).failsafes


class Supervised:
    """A supervisor whose conditions are given, by the clock of its ticks."""

    def __init__(self) -> None:
        self.supervisor = _supervisor()
        self.details: dict[Condition, str] = {}
        self.supervisor._observer = SimpleNamespace(update=lambda view, context: None)
        self.supervisor._monitor = SimpleNamespace(update=lambda facts: dict(self.details))

    def decide(
        self, now_ns: int, *, situation: Situation = Situation.FLYING, **held: str
    ) -> FailsafeDecision:
        """Return the decision of a tick in which conditions hold, each with its detail."""
        self.details = {Condition[name]: detail for name, detail in held.items()}
        view: Any = SimpleNamespace(now_ns=now_ns)
        decision: FailsafeDecision = self.supervisor.decide(view, None, situation)
        return decision

    def told(
        self, now_ns: int, *, situation: Situation = Situation.FLYING, **held: str
    ) -> list[str]:
        """Return the codes of what is told at a tick in which conditions hold."""
        decision = self.decide(now_ns, situation=situation, **held)
        return [report.code for report in decision.reports]


@pytest.fixture
def supervised() -> Supervised:
    return Supervised()


def test_a_condition_is_told_once_while_it_holds_and_anew_after_three_seconds(
    supervised: Supervised,
) -> None:
    assert supervised.told(0, BUS_LOST="") == ["bus-lost"]
    assert supervised.told(S, BUS_LOST="") == []
    # it is gone for three seconds, and comes back
    assert supervised.told(4 * S) == []
    assert supervised.told(4 * S, BUS_LOST="") == []
    # and for longer
    assert supervised.told(7 * S + 20_000_000) == []
    assert supervised.told(7 * S + 40_000_000, BUS_LOST="") == ["bus-lost"]


def test_what_was_told_in_one_flight_is_told_again_in_the_next(supervised: Supervised) -> None:
    assert supervised.told(0, BUS_LOST="") == ["bus-lost"]
    assert supervised.told(S, situation=Situation.GROUND, BUS_LOST="") == []
    assert supervised.told(S + 20_000_000, BUS_LOST="") == ["bus-lost"]


def test_another_vehicle_is_told_of_and_another_number_is_not(supervised: Supervised) -> None:
    assert supervised.told(0, NEIGHBOUR_SILENT="mav1") == ["neighbour-silent"]
    assert supervised.told(S, NEIGHBOUR_SILENT="mav1, mav2") == ["neighbour-silent"]
    assert supervised.told(2 * S, NEIGHBOUR_SILENT="mav1, mav2") == []
    assert supervised.told(3 * S, POSITION_INACCURATE="PX4 says 3.1 m") == ["position-inaccurate"]
    assert supervised.told(4 * S, POSITION_INACCURATE="PX4 says 3.2 m") == []


def test_others_rely_on_the_law_only_while_attitude_and_setpoints_follow_it(
    supervised: Supervised,
) -> None:
    supervisor = supervised.supervisor
    supervised.told(0)
    assert supervisor.is_law_followed
    supervised.told(1, ATTITUDE_NOT_FOLLOWED="")
    assert not supervisor.is_law_followed

    supervised.told(2, NOT_FINITE="")
    assert supervisor.must_be_level
    assert not supervisor.is_law_followed


def test_a_move_is_refused_while_a_condition_demands_to_hold_or_more(
    supervised: Supervised,
) -> None:
    supervised.told(0)
    assert supervised.supervisor.move_refusal() is None
    supervised.told(1, ORDER_OVERDUE="")
    assert supervised.supervisor.move_refusal() is None
    supervised.told(2, WIND_NEAR="")  # it is slower, and moves
    assert supervised.supervisor.move_refusal() is None
    supervised.told(3, FENCE_BREACH="")
    assert "Order it again when this condition has ended." in supervised.supervisor.move_refusal()


def test_the_strongest_condition_decides_and_says_why(supervised: Supervised) -> None:
    assert supervised.decide(0) == FailsafeDecision()

    decision = supervised.decide(S, WIND_NEAR="", BATTERY_LOW="", BUS_LOST="no link")
    assert decision.action is Action.LAND
    assert decision.cause == "Battery at the landing level: landing."
    assert decision.outcome == "failed"
    assert supervised.supervisor.action is Action.LAND
    assert supervised.supervisor.conditions == {
        Condition.WIND_NEAR,
        Condition.BATTERY_LOW,
        Condition.BUS_LOST,
    }


def test_an_order_that_is_overdue_has_timed_out_if_nothing_stronger_ends_it(
    supervised: Supervised,
) -> None:
    decision = supervised.decide(0, ORDER_OVERDUE="still 2.00 m to go")
    assert decision.outcome == "timed out"
    assert "(still 2.00 m to go)" in decision.cause
    assert supervised.decide(1, ORDER_OVERDUE="", BATTERY_LOW="").outcome == "failed"


@pytest.mark.parametrize(
    ("name", "situation", "severity"),
    [
        ("BUS_LOST", Situation.FLYING, "warning"),
        ("FENCE_BREACH", Situation.FLYING, "warning"),  # it holds
        ("BATTERY_LOW", Situation.FLYING, "critical"),  # it lands
        ("AUTOPILOT_SILENT", Situation.FLYING, "critical"),
        ("POSITION_JUMPED", Situation.LANDING, "warning"),
    ],
)
def test_a_report_is_critical_if_the_flight_ends(
    supervised: Supervised, name: str, situation: Situation, severity: str
) -> None:
    (report,) = supervised.decide(0, situation=situation, **{name: ""}).reports
    assert report.severity == severity


def test_a_condition_is_told_again_when_it_demands_more_and_not_when_it_demands_less(
    supervised: Supervised,
) -> None:
    lands, flies = Situation.LANDING, Situation.FLYING
    both = {"POSITION_JUMPED": "", "REPORTS_CONTRADICT": ""}
    assert supervised.told(0, situation=lands, **both) == ["position-jumped", "reports-contradict"]
    assert supervised.told(1, situation=flies, **both) == ["position-jumped"]  # it holds now
    assert supervised.told(2, situation=lands, **both) == []
    assert supervised.told(3, situation=flies, **both) == []


def test_a_quiet_condition_is_not_told_and_does_not_hide_another(supervised: Supervised) -> None:
    assert supervised.told(0, LOOP_LATE="") == []
    assert supervised.told(1, LOOP_LATE="", BUS_LOST="") == ["bus-lost"]


def test_what_has_failed_stays_silent_and_keeps_its_action(supervised: Supervised) -> None:
    supervised.decide(0, AUTOPILOT_SILENT="")
    assert supervised.decide(1, situation=Situation.SILENT, BUS_LOST="") == FailsafeDecision()
    assert supervised.supervisor.action is Action.STOP


def test_an_action_lasts_until_an_order_or_the_ground(supervised: Supervised) -> None:
    supervisor = supervised.supervisor
    supervised.decide(0, BATTERY_LOW="")
    supervised.decide(1)
    assert supervisor.action is Action.LAND
    supervisor.begin_order()
    supervised.decide(2)
    assert supervisor.action is Action.GO_ON

    supervised.decide(3, BATTERY_LOW="")
    supervised.decide(4, situation=Situation.GROUND)
    assert supervisor.action is Action.GO_ON
    # on the ground the action is that of the tick
    decision = supervised.decide(5, situation=Situation.GROUND, BATTERY_LOW="")
    assert (decision, supervisor.action) == (FailsafeDecision(), Action.REFUSE)


def test_a_vehicle_that_holds_still_follows_the_law(supervised: Supervised) -> None:
    supervised.decide(0, BUS_LOST="", WIND_NEAR="")
    assert not supervised.supervisor.must_be_level
    assert supervised.supervisor.is_law_followed


def test_telemetry_has_conditions_in_their_order_and_the_action_in_words(
    supervised: Supervised,
) -> None:
    supervised.decide(0, BATTERY_LOW="", BUS_LOST="")
    conditions, action = supervised.supervisor.in_words()
    assert conditions == (Condition.BUS_LOST.value, Condition.BATTERY_LOW.value)
    assert action == "landing"
