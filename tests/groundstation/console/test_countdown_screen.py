"""The question before a start at a time of the wall clock, and the key that stops it."""

from __future__ import annotations

import pytest

from groundstation.console.screens.countdown_screen import CountdownScreen
from groundstation.console.widgets.result_lines import ResultLines
from groundstation.missions.mission_orders import CountdownQuestion, MissionOrders
from tests.groundstation.console.rig import Rig
from tests.groundstation.console.seeing import words

LINES = ["Begins in 12 min 34 s, when all are still ready.", "Same time within 0.004 s: mav0."]


@pytest.mark.parametrize("reasons", [(), ("mav1's computer is 3.0 s ahead of this one.",)])
async def test_enter_begins_the_countdown_unless_a_clock_speaks_against_it(
    rig: Rig, reasons: tuple[str, ...]
) -> None:
    begun: list[str] = []
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        question = CountdownQuestion("show at 21:30:00 CET", LINES, reasons)
        rig.app._ask_countdown(lambda: question, lambda: begun.append("begun"))
        await pilot.pause(0.02)
        assert isinstance(rig.app.screen, CountdownScreen)
        assert "Same time within 0.004 s: mav0." in words(rig.app, "vehicles")
        assert ("✖ mav1's computer is 3.0 s" in words(rig.app, "answer")) == bool(reasons)
        await pilot.press("enter")
        assert begun == ([] if reasons else ["begun"])
        await pilot.press("escape")
        assert not isinstance(rig.app.screen, CountdownScreen)
        assert len(begun) == int(not reasons)


async def test_hold_all_closes_the_question_unanswered(rig: Rig) -> None:
    begun: list[str] = []
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        question = CountdownQuestion("show at 21:30:00 CET", LINES, ())
        rig.app._ask_countdown(lambda: question, lambda: begun.append("begun"))
        await pilot.pause(0.02)
        await pilot.press("f8")
        assert not isinstance(rig.app.screen, CountdownScreen)
        assert not begun


async def test_the_key_says_when_there_is_no_countdown(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        await pilot.press("x")
        assert "No countdown of a mission that was started here" in rig.line(ResultLines)


@pytest.mark.parametrize("key", ["f9", "f8", "x"])
async def test_land_all_and_hold_all_stop_the_countdown_as_its_own_key_does(
    rig: Rig, key: str
) -> None:
    stopped: list[str] = []

    class Missions(MissionOrders):
        def __init__(self) -> None:
            self._run = None  # no mission flies

        def stop_countdown(self) -> str:
            stopped.append("stopped")
            return "Stopped."

    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        rig.app.orders.missions = Missions()
        await pilot.press(key)
        assert stopped == ["stopped"]
