"""Land, hold and kill go at once, from every screen; what became of an order, and what to do."""

from __future__ import annotations

from typing import cast

from msgspec.structs import replace

from groundstation.console.app import ConsoleApp
from groundstation.console.clients import ConsoleClient
from groundstation.console.screens.dialogs import QuitScreen
from groundstation.console.screens.preview_screen import PreviewScreen
from groundstation.console.widgets.bars import StatusBar
from groundstation.console.widgets.event_log import EventLog
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.notices import NoticeLines
from groundstation.console.widgets.result_lines import ResultLines
from groundstation.fleet import state as fleet_state
from groundstation.orders.grammar import OrderError
from groundstation.orders.intents import Intent
from groundstation.orders.result import OrderResult
from onboard.bus.schema import Event
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.fake import FakeClient
from tests.groundstation.console.rig import Rig, StillClient
from tests.groundstation.console.seeing import see


async def test_an_emergency_goes_at_once_while_a_preview_computes_and_ends_it(
    fleet: FleetConfig,
) -> None:
    rig = Rig(fleet, None)
    async with rig.app.run_test(size=(80, 24)) as pilot:
        for key, order in (("ctrl+l", "land"), ("f9", "land"), ("ctrl+o", "hold"), ("f8", "hold")):
            rig.hover()
            rig.client.handles.clear()
            screen = await rig.preview(pilot, "move all 0 1 1")
            assert screen.prepared.is_computing
            await pilot.press(key)
            assert rig.client.ordered == [f"{order} mav0,mav1,mav2"], key
            assert not isinstance(rig.app.screen, PreviewScreen), key


async def test_an_emergency_ends_all_questions_that_lie_on_each_other(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        for key in ("ctrl+l", "ctrl+o", "f7", "f6"):
            rig.hover()
            await rig.preview(pilot, "move all 0 1 1")
            await pilot.press("ctrl+q")
            assert isinstance(rig.app.screen, QuitScreen)
            await pilot.press(key)
            assert len(rig.app.screen_stack) == 1, key


async def test_land_all_and_hold_all_go_from_every_screen(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        for screens in [("question_mark",), ("A",), ("q",), ("colon", "x")]:
            rig.hover()
            rig.client.handles.clear()
            await pilot.press(*screens, "ctrl+o", "ctrl+l", "escape")
            assert rig.client.ordered == ["hold mav0,mav1,mav2", "land mav0,mav1,mav2"], screens


async def test_a_hold_that_a_key_has_sent_early_is_not_taken_for_a_landing(rig: Rig) -> None:
    """The terminal's thread sends an emergency at once; the loop may handle a signal before it."""
    async with rig.app.run_test(size=(80, 24)):
        rig.hover()
        rig.app.orders.send_urgent("f8")
        await rig.app.orders.order_all("land")
        assert rig.client.ordered == ["hold mav0,mav1,mav2", "land mav0,mav1,mav2"]
        await rig.app.orders.order_all("hold", is_by_key=True)
        assert len(rig.client.ordered) == 2, "shown, and not sent again"


async def test_keys_mean_the_marked_vehicles_else_the_one_under_the_cursor(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        rig.app.refresh_fleet()
        await pilot.press("down", "f7")
        rig.app.panels.table.mark(("mav0", "mav2"))
        await pilot.press("f6", "w")
        assert rig.client.ordered == ["land mav1", "hold mav0,mav2", "locate mav0,mav2"]
        await pilot.press("f4")
        assert rig.app.panels.order_line.value == "move mav0,mav2 "
        await pilot.press("1")
        assert rig.app.panels.order_line.value == "move mav0,mav2 1"


async def test_the_row_of_a_vehicle_that_shows_itself_blinks_when_it_says_so(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.stand()
        await pilot.press("w")
        assert rig.client.ordered == ["locate mav0"]

        def is_lit(step: int) -> bool:
            rig.client.skew_ns += int(0.3e9)
            rig.stand()
            rig.app.refresh_fleet()
            row = rig.app.panels.table.render_line(1)
            return any(segment.style is not None and segment.style.reverse for segment in row)

        assert not any(map(is_lit, range(4)))
        event = Event(
            vehicle="mav0", stamp_ns=1, severity="info", code="identify", sentence="Listen."
        )
        rig.client.state = fleet_state.fold(rig.client.state, event, rig.client.now_ns())
        rig.app.refresh_fleet()
        lit = [is_lit(step) for step in range(20)]
        assert 4 <= sum(lit) <= 8
        assert not any(lit[-5:])


async def test_a_killed_vehicle_stays_latched_until_it_is_reset(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.stand()
        await pilot.press("f12", "f12")
        assert rig.client.ordered == ["kill mav0"]
        assert "KILLED mav0" in rig.line(NoticeLines)
        await rig.write(pilot, "takeoff all 1.0")
        assert "mav0 was killed" in rig.said
        assert rig.client.ordered == ["kill mav0"]
        await pilot.press("escape", "colon", *"reset mav0", "enter")
        assert rig.line(NoticeLines) == ""
        await rig.preview(pilot, "takeoff all 1.0")


async def test_a_silent_vehicle_outside_the_fleet_file_is_forgotten_by_a_reset(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.stand()
        rig.client.hear("ghost", is_armed=True)
        rig.client.skew_ns += int(9e9)
        await rig.write(pilot, "reset ghost")
        assert "ghost is forgotten" in rig.line(ResultLines)
        assert rig.client.state.unlisted == ()


async def test_a_killed_vehicle_on_the_ground_looks_killed_until_it_is_reset(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await pilot.press("f12", "f12")
        rig.stand(state="landed", reason="Killed by order of somebody.")
        await see(rig.app, pilot)
        killed, other = rig.line(FleetTable).splitlines()[1:3]
        assert "✖ killed" in killed
        assert "reset mav0" in killed
        assert "○ landed" in other

        await pilot.press("enter")
        await see(rig.app, pilot)
        page = rig.screen_text
        assert "NO-GO: killed" in page
        assert "ready" not in page

        await pilot.press("escape")
        await rig.write(pilot, "reset mav0")
        await see(rig.app, pilot)
        assert "✖ killed" not in rig.line(FleetTable)


async def test_a_kill_that_did_not_leave_is_not_latched(fleet: FleetConfig) -> None:
    class Silent:
        """A client that lets no order through, as a read-only console has."""

        def __init__(self, client: FakeClient) -> None:
            self.client = client

        @property
        def state(self) -> fleet_state.FleetState:
            return self.client.state

        def now_ns(self) -> int:
            return self.client.now_ns()

        async def submit(self, order: Intent | str) -> OrderResult:
            raise OrderError("This console only watches.")

    app = ConsoleApp(fleet, cast(ConsoleClient, Silent(StillClient(fleet))))
    async with app.run_test(size=(120, 30)) as pilot:
        await pilot.press("f12", "f12", "ctrl+l", "f3", "w", "colon", *"move all 0 0 1", "enter")
        assert app.query_one(NoticeLines).sentences == []
        said = app.query_one(EventLog).sentences
        assert sum("This console only watches." in one for one in said) == 5
        assert app.query_one(NoticeLines).sentences == []


async def test_a_written_kill_needs_enter_twice_within_a_second(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.hover()
        await rig.write(pilot, "kill mav1")
        assert rig.client.ordered == []
        assert "KILL mav1?" in rig.line(StatusBar)
        rig.client.skew_ns += int(1.5e9)
        await pilot.press("enter")
        assert rig.client.ordered == []
        await pilot.press("enter")
        assert rig.client.ordered == ["kill mav1"]


async def test_the_first_press_of_a_kill_says_who_is_below(rig: Rig) -> None:
    async with rig.app.run_test(size=(160, 30)) as pilot:
        rig.hover()
        for height_m, name in enumerate(("mav0", "mav1")):
            rig.client.hear(
                name, state="flying", is_airborne=True, position_enu_m=(0.0, 0.0, 1.0 + height_m)
            )
        await rig.write(pilot, "kill mav1")
        assert rig.client.ordered == []
        assert "mav1 falls on mav0, 1.0 m below." in rig.line(ResultLines)


async def test_a_failed_order_says_why_and_what_can_be_done(rig: Rig) -> None:
    async with rig.app.run_test(size=(160, 30)) as pilot:
        rig.hover()
        await pilot.press("ctrl+l")
        handle = rig.client.handles[0]
        handle.update("mav0", "done", "")
        sentence = "mav1's agent did not answer within 0.3 s. Is it running?"
        handle.update("mav1", "no answer", sentence)
        await pilot.pause(0.05)
        line = rig.line(ResultLines)
        assert "mav0 ✔ done" in line
        assert f"{sentence} In the air: ctrl+l lands everybody" in line


async def test_keys_stop_a_show_for_those_who_fly_it_and_bring_home_is_shown_first(
    rig: Rig,
) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        rig.app.refresh_fleet()
        await pilot.press("p")
        assert rig.client.ordered == []  # nobody follows a path

        for name in ("mav0", "mav2"):
            view = rig.client.state.vehicles[name]
            assert view.telemetry is not None
            told = replace(view.telemetry, show_id="s", sequence=view.telemetry.sequence + 1)
            rig.client.state = fleet_state.fold(rig.client.state, told, rig.client.now_ns())
        await pilot.press("p", "r")
        assert rig.client.ordered == ["pause mav0,mav2", "resume mav0,mav2"]
        await pilot.press("H")
        await pilot.pause()
        assert isinstance(rig.app.screen, PreviewScreen)
        assert rig.app.screen.prepared.intent.verb == "bring_home"
