"""Orders by word and by key: previews, refusals, emergencies, the kill latch, who operates, history, pasted text."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import pytest
from textual import events
from textual.pilot import Pilot

from groundstation import fleet as fleet_state
from groundstation.forecast import Forecast, Leg
from groundstation.forecaster import Forecaster, ForecastFailed
from groundstation.handle import OrderHandle
from groundstation.operator import SILENCE_S
from groundstation.orders import Intent, OrderError
from groundstation.tui.app import ConsoleApp
from groundstation.tui.screens.dialogs import QuitScreen
from groundstation.tui.screens.preview import PreviewScreen
from groundstation.tui.widgets.bars import StatusBar
from groundstation.tui.widgets.event_log import EventLog
from groundstation.tui.widgets.notices import NoticeLines
from groundstation.tui.widgets.order_line import OrderLine, completions
from groundstation.tui.widgets.results import ResultLine
from onboard.bus.schema import Event
from onboard.config import FleetConfig
from tests.tui.fake import FakeClient
from tests.tui.live import until

SLOTS = {"mav0": (-1.5, 0.0, 1.0), "mav1": (0.0, 0.0, 1.0), "mav2": (1.5, 0.0, 1.0)}
FINE = Forecast(closest_m=0.95, pair=("mav0", "mav1"), closest_s=2.0, now_m=1.5, duration_s=7.0)


class Oracle(Forecaster):
    """Foretells what a test wants, at once or when it is let."""

    def __init__(self, told: Forecast | None = FINE) -> None:
        super().__init__()
        self.told = told
        self.asked: list[dict[str, Leg]] = []

    async def start(self) -> None:
        return

    async def forecast(self, fleet: FleetConfig, legs: Mapping[str, Leg], *, is_takeoff: bool = False) -> Forecast:
        self.asked.append(dict(legs))
        while self.told is None:  # noqa: ASYNC110 - tests set it from outside
            await asyncio.sleep(0.01)
        return self.told


class StillClient(FakeClient):
    """Its clock moves only when a test says so: typing takes long on a busy machine, and silence would set in."""

    def now_ns(self) -> int:
        return int(1e12) + self.skew_ns


class Rig:
    """A console with a client that pretends and an oracle."""

    def __init__(self, fleet: FleetConfig, told: Forecast | None = FINE) -> None:
        self.client = StillClient(fleet)
        self.app = ConsoleApp(fleet, self.client)
        self.oracle = Oracle(told)
        self.app._forecaster = self.oracle

    def stand(self, **changes: Any) -> None:
        """Everybody on the ground and ready."""
        self._hear({"state": "ready", "is_airborne": False, "is_armed": False, "velocity_enu_m_s": (0.0, 0.0, 0.0)},
                   0.0, changes)  # fmt: skip

    def hover(self, **changes: Any) -> None:
        """Everybody in the air, in a row."""
        self._hear({"state": "flying", "velocity_enu_m_s": (0.0, 0.0, 0.0)}, 1.0, changes)

    def _hear(self, base: dict[str, Any], height_m: float, changes: dict[str, Any]) -> None:
        for name, (x, y, _) in SLOTS.items():
            spot = (x, y, height_m)
            self.client.hear(name, **{**base, "position_enu_m": spot, "goal_position_enu_m": spot, **changes})

    def line(self, kind: type) -> str:
        widget = self.app.screen_stack[0].query_one(kind)
        return "\n".join(widget.render_line(y).text for y in range(widget.size.height))

    @property
    def screen_text(self) -> str:
        """What the terminal shows."""
        return "\n".join(strip.text for strip in self.app.screen._compositor.render_strips())

    @property
    def said(self) -> str:
        return "\n".join(self.app.screen_stack[0].query_one(EventLog).sentences)

    async def preview(self, pilot: Pilot[int], *keys: str) -> PreviewScreen:
        """Press keys until the question is there and answered by the oracle."""
        await pilot.press(*keys)
        await pilot.pause(0.05)
        screen = self.app.screen
        assert isinstance(screen, PreviewScreen), self.said
        self.client.skew_ns += int(0.4e9)  # a person reads
        return screen


@pytest.fixture
def rig(fleet: FleetConfig) -> Rig:
    return Rig(fleet)


# -- preview -------------------------------------------------------------------------------------------------------


async def test_take_off_is_shown_first_and_sent_by_enter(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        screen = await rig.preview(pilot, "colon", *"takeoff all 1.2", "enter")
        assert rig.client.ordered == []
        words = str(screen._words.render())
        assert "1 mav1  → 0.00 0.00 1.20 m" in words
        assert "closest: 0.95 m, mav0 and mav1, after 2.0 s" in words
        assert "takes about 7 s" in words
        await pilot.press("enter")
        assert rig.client.ordered == ["takeoff mav0,mav1,mav2 1.2"]
        assert not isinstance(rig.app.screen, PreviewScreen)


@pytest.mark.parametrize("key", ["escape", "q", "n"])
async def test_a_preview_that_is_dropped_sends_nothing(rig: Rig, key: str) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await rig.preview(pilot, "colon", *"move all 0 1 1", "enter")
        await pilot.press(key)
        await pilot.press("enter")
        assert rig.client.ordered == []
        assert rig.app.is_running


@pytest.mark.parametrize(
    ("told", "words"),
    [
        (Forecast(closest_m=0.41, pair=("mav0", "mav2"), now_m=1.5, duration_s=5.0), "within 0.41 m, below the safety"),
        (Forecast(closest_m=1.0, now_m=1.5, duration_s=5.0, outside=("mav1",)), "mav1 would leave the fence"),
        (Forecast(closest_m=1.0, now_m=1.5, duration_s=float("inf")), "would not arrive"),
    ],
)
async def test_what_would_end_badly_is_refused_in_words(fleet: FleetConfig, told: Forecast, words: str) -> None:
    rig = Rig(fleet, told)
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        screen = await rig.preview(pilot, "colon", *"move all 0 1 1", "enter")
        assert words in str(screen._answer.render())
        await pilot.press("enter", "enter")
        assert rig.client.ordered == []


async def test_vehicles_too_close_already_may_be_moved_apart(fleet: FleetConfig) -> None:
    rig = Rig(fleet, Forecast(closest_m=0.7, pair=("mav0", "mav1"), now_m=0.7, duration_s=5.0))
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        await rig.preview(pilot, "colon", *"move all 0 1 1", "enter")
        await pilot.press("enter")
        assert len(rig.client.ordered) == 1


async def test_who_is_not_ready_is_named_and_the_others_are_offered(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        rig.client.hear("mav1", state="waiting", is_airborne=False, not_ready=("The battery is at 12 %.",))
        screen = await rig.preview(pilot, "colon", *"takeoff all 1.0", "enter")
        answer = str(screen._answer.render())
        assert "mav1 is not ready: The battery is at 12 %." in answer
        assert "takeoff mav0,mav2 1" in answer
        assert rig.oracle.asked == []
        await pilot.press("enter")
        assert rig.client.ordered == []


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ("move all 0 1 1", "mav0 does not fly (it is ready): order take-off first."),
        ("move mav1 99 0 1", "outside the fence"),
        ("takeoff all 55", "outside 0.2 to"),
        ("formation triangle 0.5 0 1 1", "keeps"),
    ],
)
async def test_orders_that_vehicles_would_refuse_are_refused_before(rig: Rig, order: str, words: str) -> None:
    async with rig.app.run_test(size=(120, 40)) as pilot:
        rig.stand()
        screen = await rig.preview(pilot, "colon", *order, "enter")
        assert words in str(screen._answer.render())
        await pilot.press("enter")
        assert rig.client.ordered == []


async def test_silent_vehicles_are_not_ordered(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        rig.client.skew_ns += int(3e9)
        screen = await rig.preview(pilot, "colon", *"takeoff all 1.0", "enter")
        assert "mav0 is not heard any more" in str(screen._answer.render())


async def test_a_fleet_that_moved_meanwhile_is_computed_again_before_anything_is_sent(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        screen = await rig.preview(pilot, "colon", *"move all 0 1 1", "enter")
        rig.oracle.told = None
        rig.client.hear("mav1", position_enu_m=(0.0, 0.9, 1.0), velocity_enu_m_s=(0.0, 0.0, 0.0))
        await pilot.press("enter")
        assert rig.client.ordered == []
        assert screen.is_computing
        assert "mav1 has moved: computed again" in str(screen._words.render())
        rig.oracle.told = FINE
        await pilot.pause(0.1)
        assert rig.oracle.asked[-1]["mav1"].start_enu_m[1] == pytest.approx(0.9, abs=0.02)
        await pilot.press("enter")
        assert len(rig.client.ordered) == 1


async def test_a_formation_without_a_place_is_sent_with_the_place_that_was_shown(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        screen = await rig.preview(pilot, "colon", *"formation triangle 1.8", "enter")
        assert screen.intent.position_enu_m is not None
        rig.client.hear("mav1", position_enu_m=(0.05, 0.05, 1.0), velocity_enu_m_s=(0.0, 0.0, 0.0))
        await pilot.press("enter")
        (handle,) = rig.client.handles
        goals = {name: order.position_enu_m for name, order in handle.plan.orders.items()}
        assert goals == screen.proposal.goals


async def test_a_second_enter_of_the_order_line_does_not_answer_the_question(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await pilot.press("colon", *"move all 0 1 1", "enter", "enter")
        assert rig.client.ordered == []


async def test_who_stands_in_the_room_is_part_of_the_forecast(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        rig.client.hear("mav2", state="landed", is_airborne=False, position_enu_m=(1.5, 0.0, 0.0))
        await rig.preview(pilot, "colon", *"move mav0 0 1.5 1", "enter")
        legs = rig.oracle.asked[0]
        assert (legs["mav0"].is_ordered, legs["mav1"].is_ordered, legs["mav2"].is_parked) == (True, False, True)


async def test_without_previews_orders_go_at_once(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client, has_preview=False)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("colon", *"takeoff all 1.0", "enter")
        assert client.ordered == ["takeoff mav0,mav1,mav2 1"]


async def test_a_forecast_that_breaks_is_a_sentence_and_no_order(rig: Rig) -> None:
    async def broken(*_: object, **__: object) -> Forecast:
        raise ForecastFailed("The forecast could not be computed (EOFError).")

    rig.oracle.forecast = broken  # type: ignore[method-assign]
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        screen = await rig.preview(pilot, "colon", *"move all 0 1 1", "enter")
        assert "could not be computed" in str(screen._answer.render())
        await pilot.press("enter")
        assert rig.client.ordered == []


# -- emergencies ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("key", "order"), [("ctrl+l", "land"), ("f9", "land"), ("ctrl+o", "hold"), ("f8", "hold")])
async def test_an_emergency_goes_at_once_while_a_preview_computes_and_ends_it(
    fleet: FleetConfig, key: str, order: str
) -> None:
    rig = Rig(fleet, None)
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        screen = await rig.preview(pilot, "colon", *"move all 0 1 1", "enter")
        assert screen.is_computing
        await pilot.press(key)
        assert rig.client.ordered == [f"{order} mav0,mav1,mav2"]
        assert not isinstance(rig.app.screen, PreviewScreen)


@pytest.mark.parametrize("screens", [("question_mark",), ("A",), ("q",), ("colon", "x")])
async def test_land_all_and_hold_all_go_from_every_screen(rig: Rig, screens: tuple[str, ...]) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await pilot.press(*screens, "ctrl+o", "ctrl+l")
        assert rig.client.ordered == ["hold mav0,mav1,mav2", "land mav0,mav1,mav2"]


async def test_keys_mean_the_marked_vehicles_else_the_one_under_the_cursor(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        rig.app.refresh_fleet()
        await pilot.press("down", "f7")
        rig.app._fleet_table.mark(("mav0", "mav2"))
        await pilot.press("f6", "w")
        assert rig.client.ordered == ["land mav1", "hold mav0,mav2", "identify mav0,mav2"]
        await pilot.press("f4")
        assert rig.app._order_line.value == "move mav0,mav2 "
        await pilot.press("1")
        assert rig.app._order_line.value == "move mav0,mav2 1"


async def test_the_row_of_a_vehicle_that_shows_itself_blinks_when_it_says_so(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.stand()
        await pilot.press("w")
        assert rig.client.ordered == ["identify mav0"]

        def is_lit(step: int) -> bool:
            rig.client.skew_ns += int(0.3e9)
            rig.stand()
            rig.app.refresh_fleet()
            row = rig.app._fleet_table.render_line(1)
            return any(segment.style is not None and segment.style.reverse for segment in row)

        assert not any(map(is_lit, range(4)))
        event = Event(vehicle="mav0", stamp_ns=1, severity="info", code="identify", sentence="Listen.")
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
        await pilot.press("colon", *"takeoff all 1.0", "enter")
        assert "mav0 was killed" in rig.said
        assert rig.client.ordered == ["kill mav0"]
        await pilot.press("escape", "colon", *"reset mav0", "enter")
        assert rig.line(NoticeLines) == ""
        await rig.preview(pilot, "colon", *"takeoff all 1.0", "enter")


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

        async def submit(self, order: Intent | str) -> OrderHandle:
            raise OrderError("This console only watches.")

    app = ConsoleApp(fleet, Silent(StillClient(fleet)))
    async with app.run_test(size=(120, 30)) as pilot:
        await pilot.press("f12", "f12", "ctrl+l", "f3", "w", "colon", *"move all 0 0 1", "enter")
        assert app.query_one(NoticeLines).sentences == []
        said = app.query_one(EventLog).sentences
        assert sum("This console only watches." in one for one in said) == 5
        assert app.query_one(NoticeLines).sentences == []


async def test_a_written_kill_needs_enter_twice_within_a_second(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.hover()
        await pilot.press("colon", *"kill mav1", "enter")
        assert rig.client.ordered == []
        assert "KILL mav1?" in rig.line(StatusBar)
        rig.client.skew_ns += int(1.5e9)
        await pilot.press("enter")
        assert rig.client.ordered == []
        await pilot.press("enter")
        assert rig.client.ordered == ["kill mav1"]


async def test_a_failed_order_says_why_and_what_can_be_done(rig: Rig) -> None:
    async with rig.app.run_test(size=(160, 30)) as pilot:
        rig.hover()
        await pilot.press("ctrl+l")
        handle = rig.client.handles[0]
        handle.update("mav0", "done", "")
        handle.update("mav1", "no answer", "mav1's agent did not answer within 0.3 s")
        await pilot.pause(0.05)
        line = rig.line(ResultLine)
        assert "mav0 ✔ done" in line
        assert "mav1's agent did not answer within 0.3 s" in line
        assert "Is its agent running?" in line


# -- the order line ------------------------------------------------------------------------------------------------


async def test_pasted_lines_become_one_that_only_enter_sends(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        await pilot.press("colon")
        rig.app._order_line.post_message(events.Paste("land mav1\nkill all\n"))
        await pilot.pause(0.05)
        assert rig.app._order_line.value == "land mav1 kill all"
        assert rig.client.ordered == []
        await pilot.press("enter")
        assert rig.client.ordered == []
        await pilot.press("ctrl+u")
        rig.app._order_line.post_message(events.Paste("land mav1\r\n"))
        await pilot.pause(0.05)
        assert rig.client.ordered == []
        await pilot.press("enter")
        assert rig.client.ordered == ["land mav1"]


async def test_who_has_given_an_order_has_left_the_order_line(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        line, table = rig.app._order_line, rig.app._fleet_table
        assert "press :" in rig.screen_text
        assert "esc leaves" not in rig.screen_text
        await pilot.press("colon")
        assert "now write" in rig.screen_text
        assert "esc leaves" in rig.screen_text
        await pilot.press(*"land mav1", "enter")
        await pilot.pause()
        assert rig.client.ordered == ["land mav1"]
        assert (rig.app.focused, line.value) == (table, "")
        assert "press :" in rig.screen_text
        assert "esc leaves" not in rig.screen_text
        await pilot.press("down", "f12", "f12")  # in a hurry: keys are keys again
        assert rig.client.ordered[1:] == ["kill mav1"]
        await rig.preview(pilot, "colon", *"move mav0 0 1.5 1", "enter")
        await pilot.press("escape")
        assert (rig.app.focused, line.value) == (table, "")


@pytest.mark.parametrize(
    "order", ["lnad all", "takeoff nobody", "take control now", "reset nobody", "move all nan 0 1"]
)
async def test_a_refused_order_stays_to_be_corrected_below_the_sentence_that_says_why(rig: Rig, order: str) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await pilot.press("colon", *order, "enter")
        await pilot.pause()
        line = rig.app._order_line
        assert (rig.app.focused, line.value, rig.client.ordered) == (line, order, [])
        assert "esc leaves" in rig.screen_text
        why = rig.line(ResultLine).strip()
        assert why[:40] in rig.said
        await pilot.press("x", "backspace")
        assert line.value == order
        await pilot.press("ctrl+u", *"hold all", "enter")
        assert rig.client.ordered == ["hold mav0,mav1,mav2"]
        assert (rig.app.focused, line.value) == (rig.app._fleet_table, "")
        await pilot.press("colon", *"hodl", "enter", "escape")
        assert (rig.app.focused, line.value) == (rig.app._fleet_table, "")


async def test_earlier_orders_come_back_also_in_the_next_run(fleet: FleetConfig, state_home: Path) -> None:
    for _ in range(2):
        rig = Rig(fleet)
        async with rig.app.run_test(size=(80, 24)) as pilot:
            rig.hover()
            await pilot.press("colon", *"land mav2", "enter", "colon", *"hold mav1", "enter", "colon", *"lan")
            await pilot.press("up", "up")
            assert rig.app._order_line.value == "land mav2"
            await pilot.press("down", "down")
            assert rig.app._order_line.value == "lan"
    assert (state_home / "covey" / "orders").read_text().splitlines() == ["land mav2", "hold mav1"] * 2
    (state_home / "covey" / "orders").write_bytes(b"\xff\x00\x1b[31m\nland mav0\n" + b"x" * 9000)
    rig = Rig(fleet)
    async with rig.app.run_test(size=(80, 24)) as pilot:
        await pilot.press("colon", "up")
        assert rig.app._order_line.value == "land mav0"


async def test_a_state_folder_that_cannot_be_written_costs_the_memory_only(
    fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/nowhere")
    rig = Rig(fleet)
    async with rig.app.run_test(size=(80, 24)) as pilot:
        await pilot.press("colon", *"land mav1", "enter", "colon", "up")
        assert rig.app._order_line.value == "land mav1"


async def test_tab_completes_what_is_certain_and_lists_the_rest(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 24)) as pilot:
        await pilot.press("colon", *"la", "tab", "space", "m", "tab")
        assert rig.app._order_line.value == "land mav"
        assert "mav0  mav1  mav2" in rig.line(ResultLine)
        await pilot.press(*"1,mav2")
        assert rig.app.focused is rig.app.screen.query_one(OrderLine)


def test_completion_knows_lists_formations_and_control(fleet: FleetConfig) -> None:
    assert completions("land mav0,m", fleet) == ["land mav0,mav1", "land mav0,mav2"]
    assert completions("formation triangle a", fleet) == ["formation triangle all"]
    assert completions("take c", fleet) == ["take control", "take control force"]
    assert completions("move mav1 1", fleet) == []


async def test_garbage_never_orders_and_never_breaks(rig: Rig) -> None:
    chance = random.Random(5)
    words = ["all", "mav0", "mav9", "9-1", "2-0", "0-", "-1", "1e999", "nan", "in", "triangle", "", "\t", "é" * 20,
             "[/b]", "take", "control", "reset", "1,,2", "force", "\x1b[2J"]  # fmt: skip
    async with rig.app.run_test(size=(80, 24)) as pilot:
        for _ in range(60):
            line = " ".join(chance.choices(words, k=chance.randint(1, 5)))
            rig.app.post_message(OrderLine.Given(line.strip() or "x"))
        await pilot.pause(0.3)
        assert rig.client.ordered == []
        assert rig.app.is_running


async def test_a_fleet_of_none_is_a_sentence(fleet: FleetConfig) -> None:
    vehicles = {name: msgspec.structs.replace(one, enabled=False) for name, one in fleet.vehicles.items()}
    rig = Rig(msgspec.structs.replace(fleet, vehicles=vehicles))
    async with rig.app.run_test(size=(80, 24)) as pilot:
        await pilot.press("ctrl+l", "f7", "f3", "f4", "escape", "w", "f12", "f12", "colon", *"land all", "enter")
        await pilot.press("colon", *"takeoff", "enter")
        assert rig.client.ordered == []
        assert "nobody to order" in rig.said


# -- who operates --------------------------------------------------------------------------------------------------


async def test_who_watches_may_only_make_things_safer(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.client.tokens.roles.see("operator.1.ground-9.alice", True)
        rig.hover()
        await until(pilot, lambda: "You watch" in rig.line(NoticeLines))
        assert "alice (ground-9) operates" in rig.line(NoticeLines), "both may be of one user"
        await pilot.press("colon", *"move all 0 1 1", "enter")
        assert "alice (ground-9) operates this fleet" in rig.said
        assert not isinstance(rig.app.screen, PreviewScreen)
        await pilot.press("escape", "ctrl+l", "ctrl+o", "f12", "f12")
        assert rig.client.ordered == ["land mav0,mav1,mav2", "hold mav0,mav1,mav2", "kill mav0"]
        await pilot.press("q")
    assert rig.app.return_value == 0
    assert len(rig.client.ordered) == 3


async def test_control_is_asked_for_and_taken_by_force_after_silence(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.client.tokens.roles.see("operator.1.ground-9.alice", True)
        rig.hover()
        await pilot.pause(0.15)
        await pilot.press("colon", *"take control force", "enter")
        assert "Ask alice first" in rig.said
        await pilot.press("colon", *"take control", "enter")
        assert "asking alice for control" in rig.line(NoticeLines)
        rig.client.skew_ns += int((SILENCE_S + 1.0) * 1e9)
        rig.hover()
        await pilot.press("colon", *"take control force", "enter")
        rig.hover()
        await pilot.pause(0.15)
        assert rig.client.control.is_operator
        assert rig.line(NoticeLines) == ""


@pytest.mark.parametrize(("key", "stays"), [("ctrl+y", False), ("ctrl+n", True)])
async def test_the_operator_gives_control_or_keeps_it(rig: Rig, key: str, stays: bool) -> None:
    async with rig.app.run_test(size=(120, 30)) as pilot:
        rig.hover()
        await pilot.pause(0.1)
        rig.client.skew_ns += int(1e9)
        rig.hover()
        await pilot.pause(0.15)
        assert rig.client.control.is_operator
        await pilot.press(key)
        assert rig.client.control.is_operator, "nobody has asked"
        rig.client.tokens.roles.see("asks.1.ground-9.bob", True)
        rig.hover()
        await pilot.pause(0.15)
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


async def test_a_bus_that_cannot_be_opened_is_a_sentence(fleet: FleetConfig) -> None:
    async def connect() -> None:
        raise OSError("the bus cannot listen")

    app = ConsoleApp(fleet, FakeClient(fleet), connect=connect)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.pause(0.2)
        assert any("the bus cannot listen" in one for one in app.screen.query_one(EventLog).sentences)
        await pilot.press("q")
    assert app.return_value == 2
