"""Who operates, who only watches, and leaving."""

from __future__ import annotations

import pytest

from groundstation.console.app import ConsoleApp
from groundstation.console.screens.dialogs import QuitScreen
from groundstation.console.screens.preview_screen import PreviewScreen
from groundstation.console.widgets.event_log import EventLog
from groundstation.console.widgets.notices import NoticeLines
from groundstation.console.widgets.result_lines import ResultLines
from groundstation.fleet.operator_control import SILENCE_S
from groundstation.missions.mission_orders import MissionOrders
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.fake import FakeClient
from tests.groundstation.console.live import until
from tests.groundstation.console.rig import Rig
from tests.groundstation.console.seeing import see


async def test_a_console_without_control_may_only_give_orders_that_make_things_safer(
    rig: Rig,
) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.client.tokens.roles.see("operator.1.ground-9.alice", True)
        rig.hover()
        await until(pilot, lambda: "You watch" in rig.line(NoticeLines))
        assert "alice (ground-9) operates" in rig.line(NoticeLines), "both may be of one user"
        await rig.write(pilot, "move all 0 1 1")
        assert "alice (ground-9) operates this fleet" in rig.said
        assert not isinstance(rig.app.screen, PreviewScreen)
        await pilot.press("escape", "ctrl+l", "ctrl+o", "f12", "f12")
        assert rig.client.ordered == ["land mav0,mav1,mav2", "hold mav0,mav1,mav2", "kill mav0"]
        await pilot.press("q")
    assert rig.app.return_value == 0
    assert len(rig.client.ordered) == 3


async def test_control_is_requested_and_taken_by_force_after_silence(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.client.tokens.roles.see("operator.1.ground-9.alice", True)
        rig.hover()
        await see(rig.app, pilot)
        await rig.write(pilot, "take control force")
        assert "Ask alice first" in rig.said
        await rig.write(pilot, "take control")
        assert "asking alice for control" in rig.line(NoticeLines)
        rig.client.skew_ns += int((SILENCE_S + 1.0) * 1e9)
        rig.hover()
        await rig.write(pilot, "take control force")
        rig.hover()
        await see(rig.app, pilot)
        assert rig.client.control.is_operator
        assert rig.line(NoticeLines) == ""


async def test_a_request_for_control_that_was_answered_is_no_longer_shown(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.client.tokens.roles.see("operator.1.ground-9.alice", True)
        rig.hover()
        await see(rig.app, pilot)
        await rig.write(pilot, "take control")
        assert "Asking alice (ground-9) for control." in rig.line(ResultLines)

        rig.client.tokens.roles.see("operator.1.ground-9.alice", False)
        rig.hover()
        await see(rig.app, pilot)
        assert rig.client.control.is_operator
        assert "You operate." in rig.line(ResultLines)


async def test_the_operator_is_told_that_giving_control_ends_the_mission(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.hover()
        await see(rig.app, pilot)
        rig.client.skew_ns += int(1e9)
        rig.hover()
        await see(rig.app, pilot)
        rig.client.tokens.roles.see("asks.1.ground-9.bob", True)
        rig.hover()
        await see(rig.app, pilot)
        assert "ctrl+y gives it, ctrl+n keeps it" in rig.line(NoticeLines)

        monkeypatch.setattr(MissionOrders, "is_flying", True)
        await see(rig.app, pilot)
        assert "ctrl+y gives it and ends the mission" in rig.line(NoticeLines)


@pytest.mark.parametrize(("key", "stays"), [("ctrl+y", False), ("ctrl+n", True)])
async def test_the_operator_gives_control_or_keeps_it(rig: Rig, key: str, stays: bool) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.hover()
        await see(rig.app, pilot)
        rig.client.skew_ns += int(1e9)
        rig.hover()
        await see(rig.app, pilot)
        assert rig.client.control.is_operator
        await pilot.press(key)
        assert rig.client.control.is_operator, "nobody has asked"
        assert "Nobody asks for control" in rig.line(ResultLines)
        rig.client.tokens.roles.see("asks.1.ground-9.bob", True)
        rig.hover()
        await see(rig.app, pilot)
        assert "bob (ground-9) asks for control" in rig.line(NoticeLines)
        await pilot.press(key)
        assert rig.client.control.is_operator is stays


async def test_leaving_a_fleet_that_flies_on_is_offered_where_it_can(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await pilot.press("q")
        assert isinstance(rig.app.screen, QuitScreen)
        await pilot.press("f")
    assert rig.app.return_value == 0
    assert rig.client.ordered == []


async def test_the_question_before_leaving_follows_who_has_landed(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        rig.app.refresh_fleet()
        await pilot.press("q")
        await see(rig.app, pilot)
        assert "mav0, mav1, mav2 fly." in rig.screen_text

        rig.client.hear("mav0", is_airborne=False)
        rig.client.hear("mav2", is_airborne=False)
        await see(rig.app, pilot)
        assert "mav1 flies." in rig.screen_text

        rig.stand()
        await see(rig.app, pilot)
        assert "All are down." in rig.screen_text
        assert "land" not in rig.screen_text.partition("All are down.")[2].partition("stay")[0]


@pytest.mark.parametrize("key", ["y", "f"])
async def test_once_all_have_landed_an_answer_to_leave_sends_no_order(rig: Rig, key: str) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await pilot.press("q")
        rig.stand()
        await pilot.press(key)
    assert rig.app.return_value == 0
    assert rig.client.ordered == []


async def test_a_bus_that_cannot_be_opened_is_a_sentence(fleet: FleetConfig) -> None:
    async def connect() -> None:
        raise OSError("the bus cannot listen")

    app = ConsoleApp(fleet, FakeClient(fleet), connect=connect)
    async with app.run_test(size=(80, 24)) as pilot:
        await until(
            pilot,
            lambda: "the bus cannot listen" in " ".join(app.screen.query_one(EventLog).sentences),
        )
        await pilot.press("q")
    assert app.return_value == 2
