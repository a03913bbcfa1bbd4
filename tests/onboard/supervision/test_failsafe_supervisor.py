"""What the failsafe supervisor tells of conditions, and when, tick by tick."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from onboard.agent.core import AgentCore
from onboard.safety.failsafe_table import Condition, Situation
from tests.onboard.agent.rig import fleet

S = 1_000_000_000


def _supervisor() -> Any:
    return AgentCore(fleet(), "mav0", boot_id=1).failsafes


class Supervised:
    """A supervisor whose conditions are given, by the clock of its ticks."""

    def __init__(self) -> None:
        self.supervisor = _supervisor()
        self.details: dict[Condition, str] = {}
        self.supervisor._observer = SimpleNamespace(look=lambda view, context: None)
        self.supervisor._monitor = SimpleNamespace(look=lambda facts: dict(self.details))

    def told(
        self, now_ns: int, *, situation: Situation = Situation.FLYING, **held: str
    ) -> list[str]:
        """Return the codes of what is told at a tick in which conditions hold."""
        self.details = {Condition[name]: detail for name, detail in held.items()}
        view: Any = SimpleNamespace(now_ns=now_ns)
        decision = self.supervisor.decide(view, None, situation)
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
