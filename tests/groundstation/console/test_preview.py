"""What arm, take-off and moves lead to is shown first, and refused in words where it would end
badly.
"""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from groundstation.console.app import ConsoleApp
from groundstation.console.screens.preview_screen import PreviewScreen
from groundstation.console.widgets.path_plan import PathPlan
from groundstation.orders.forecast import Forecast
from groundstation.orders.forecast_process import ForecastFailed
from groundstation.orders.intents import Formation
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.fake import FakeClient
from tests.groundstation.console.rig import FINE, Rig
from tests.groundstation.console.scenes import crowd, named_by_numbers
from tests.groundstation.console.seeing import words


async def test_take_off_is_shown_first_and_sent_by_enter(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        await rig.preview(pilot, "takeoff all 1.2")
        assert rig.client.ordered == []
        shown = words(rig.app, "vehicles")
        assert "1 mav1  → 0.00 0.00 1.20 m" in shown
        assert "closest: 0.95 m, mav0 and mav1, after 2.0 s" in shown
        assert "takes about 7 s" in shown
        await pilot.press("enter")
        assert rig.client.ordered == ["takeoff mav0,mav1,mav2 1.2"]
        assert not isinstance(rig.app.screen, PreviewScreen)


async def test_a_preview_of_vehicles_named_by_numbers_shows_their_names(fleet: FleetConfig) -> None:
    rig = Rig(named_by_numbers(fleet))
    async with rig.app.run_test(size=(100, 30)) as pilot:
        for east_m, name in enumerate(("2", "1", "0")):
            spot = (2.0 * east_m - 2.0, 0.0, 0.0)
            rig.client.hear(name, state="ready", is_airborne=False, position_enu_m=spot)
        await rig.preview(pilot, "takeoff 2 1.2")
        assert "\n2  → -2.00 0.00 1.20 m" in f"\n{words(rig.app, 'vehicles')}"
        picture = rig.app.screen.query_one(PathPlan)
        drawn = "".join(picture.render_line(y).text for y in range(picture.size.height))
        assert re.findall(r"\d", drawn)[:1] == ["2"], "the vehicle stands farthest in the west"


async def test_a_preview_of_a_crowd_shows_whole_numbers_only() -> None:
    rig = Rig(crowd(30, "mav{}"))
    async with rig.app.run_test(size=(50, 14)) as pilot:
        for index, name in enumerate(rig.app.fleet.enabled_names):
            spot = (1.5 * (index % 6) - 4.0, 1.5 * (index // 6) - 4.0, 1.0)
            rig.client.hear(name, state="flying", is_airborne=True, position_enu_m=spot)
        await rig.preview(pilot, "move all 1 1 1.2")
        picture = rig.app.screen.query_one(PathPlan)
        drawn = [picture.render_line(y).text for y in range(picture.size.height)]
        numbers = [int(number) for line in drawn for number in re.findall(r"\d+", line)]
        assert len(numbers) >= 10
        assert len(set(numbers)) == len(numbers)
        assert max(numbers) < 30


async def test_a_preview_that_is_dropped_sends_nothing(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        for key in ("escape", "q", "n"):
            await rig.preview(pilot, "move all 0 1 1")
            await pilot.press(key)
            assert not isinstance(rig.app.screen, PreviewScreen), key
            assert rig.client.ordered == [], key
            assert rig.app.is_running, key


async def test_a_slow_preview_counts_and_says_that_enter_waits(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        rig.oracle.answer = None
        await rig.preview(pilot, "move all 0 1 1")
        rig.client.skew_ns += int(6e9)
        rig.hover()
        await pilot.press("enter")
        shown = words(rig.app, "answer")
        assert "6 s: enter waits for the paths" in shown
        assert rig.client.ordered == []


async def test_an_order_that_was_flown_ahead_once_says_so(rig: Rig) -> None:
    """Until the code is compiled another process interprets it, and flies fewer flights."""
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        rig.oracle.answer = replace(FINE, flight_count=1)
        await rig.preview(pilot, "move all 0 1 1")
        assert "flown ahead once" in words(rig.app, "vehicles")


async def test_an_order_that_would_end_badly_is_refused_in_words(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        for forecast, reason in [
            (
                Forecast(closest_m=0.41, pair=("mav0", "mav2"), now_m=1.5, duration_s=5.0),
                "within 0.41 m, below the",
            ),
            (
                Forecast(closest_m=1.0, now_m=1.5, duration_s=5.0, outside=("mav1",)),
                "mav1 would leave the fence",
            ),
            (Forecast(closest_m=1.0, now_m=1.5, duration_s=float("inf")), "would not arrive"),
        ]:
            rig.oracle.answer = forecast
            await rig.preview(pilot, "move all 0 1 1")
            assert reason in words(rig.app, "answer")
            await pilot.press("enter", "enter")
            assert rig.client.ordered == [], reason
            await pilot.press("escape")


async def test_vehicles_too_close_already_may_be_moved_apart(fleet: FleetConfig) -> None:
    rig = Rig(fleet, Forecast(closest_m=0.7, pair=("mav0", "mav1"), now_m=0.7, duration_s=5.0))
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        await rig.preview(pilot, "move all 0 1 1")
        await pilot.press("enter")
        assert len(rig.client.ordered) == 1


async def test_vehicles_that_are_not_ready_are_named_and_the_others_are_offered(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        rig.client.hear(
            "mav1", state="waiting", is_airborne=False, not_ready=("The battery is at 12 %.",)
        )
        await rig.preview(pilot, "takeoff all 1.0")
        answer = words(rig.app, "answer")
        assert "mav1 is not ready: The battery is at 12 %." in answer
        assert "takeoff mav0,mav2 1" in answer
        assert rig.oracle.requested == []
        await pilot.press("enter")
        assert rig.client.ordered == []


async def test_orders_that_vehicles_would_refuse_are_refused_before(rig: Rig) -> None:
    async with rig.app.run_test(size=(120, 40)) as pilot:
        rig.stand()
        for order, reason in [
            ("move all 0 1 1", "mav0 does not fly (it is ready): order take-off first."),
            ("move mav1 99 0 1", "outside the geofence"),
            ("takeoff all 55", "is above 3 m, the top of the fence"),
            ("formation triangle 0.5 0 1 1", "keeps"),
        ]:
            await rig.preview(pilot, order)
            assert reason in words(rig.app, "answer"), order
            await pilot.press("enter", "escape")
            assert rig.client.ordered == [], order


async def test_silent_vehicles_are_not_ordered(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        rig.client.skew_ns += int(3e9)
        await rig.preview(pilot, "takeoff all 1.0")
        assert "mav0 is not heard any more" in words(rig.app, "answer")


async def test_a_fleet_that_moved_meanwhile_is_computed_again_before_anything_is_sent(
    rig: Rig,
) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        screen = await rig.preview(pilot, "move all 0 1 1")
        rig.oracle.answer = None
        rig.client.hear("mav1", position_enu_m=(0.0, 0.9, 1.0), velocity_enu_m_s=(0.0, 0.0, 0.0))
        await pilot.press("enter")
        assert rig.client.ordered == []
        assert screen.prepared.is_computing
        assert "mav1 has moved: computed again" in words(rig.app, "vehicles")
        rig.oracle.answer = FINE
        await pilot.pause(0.2)
        assert rig.oracle.requested[-1]["mav1"].start_enu_m[1] == pytest.approx(0.9, abs=0.02)
        await pilot.press("enter")
        assert len(rig.client.ordered) == 1


@pytest.mark.parametrize("is_noticed_first", [True, False])
async def test_a_question_from_before_another_persons_hold_is_not_sent(
    rig: Rig, is_noticed_first: bool
) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover(taken_order_id="ground-7-1", taken_order_kind="hold", taken_order_from="old")
        screen = await rig.preview(pilot, "move all 0 1 1")
        assert screen.prepared.is_sendable

        rig.hover(taken_order_id="ground-2-1", taken_order_kind="hold", taken_order_from="ada (b)")
        if is_noticed_first:
            screen.prepared.check()
            await pilot.pause()
        await pilot.press("enter", "enter")

        assert rig.client.ordered == []
        assert "ada (b) has ordered hold mav0, mav1, mav2 meanwhile" in words(rig.app, "answer")

        await pilot.press("escape")
        await rig.preview(pilot, "move all 0 1 1")
        await pilot.press("enter")
        assert rig.client.ordered == ["move mav0,mav1,mav2 0 1 1"]


async def test_a_take_off_is_not_sent_over_an_order_to_stop_that_vehicles_on_the_ground_refuse(
    rig: Rig,
) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.stand()
        rig.client.say("ground-2-1 land all refused: It stands on the ground.", code="order")
        await rig.preview(pilot, "takeoff all 1.2")
        rig.client.say("ground-2-2 locate mav0 accepted.", code="order")
        rig.client.say("ground-2-3 land all refused: It stands on the ground.", code="order")
        await pilot.press("enter", "enter")

        assert rig.client.ordered == []
        assert "ground-2 has ordered mav0 to land meanwhile" in words(rig.app, "answer")


async def test_a_formation_without_a_position_is_sent_with_the_position_that_was_shown(
    rig: Rig,
) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        screen = await rig.preview(pilot, "formation triangle 1.8")
        assert isinstance(screen.prepared.intent, Formation)
        assert screen.prepared.intent.position_enu_m is not None
        rig.client.hear("mav1", position_enu_m=(0.05, 0.05, 1.0), velocity_enu_m_s=(0.0, 0.0, 0.0))
        await pilot.press("enter")
        (handle,) = rig.client.handles
        goals = {name: order.position_enu_m for name, order in handle.planned.orders.items()}
        assert screen.prepared.preview is not None
        assert goals == screen.prepared.preview.goals


async def test_a_second_enter_of_the_order_line_does_not_answer_the_question(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await pilot.press("colon", *"move all 0 1 1", "enter", "enter")
        assert rig.client.ordered == []


async def test_vehicles_that_are_not_ordered_are_part_of_the_forecast(rig: Rig) -> None:
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        rig.client.hear("mav2", state="landed", is_airborne=False, position_enu_m=(1.5, 0.0, 0.0))
        await rig.preview(pilot, "move mav0 0 1.5 1")
        legs = rig.oracle.requested[0]
        assert (
            legs["mav0"].is_by_this_order,
            legs["mav1"].is_by_this_order,
            legs["mav2"].is_parked,
        ) == (
            True,
            False,
            True,
        )


async def test_without_previews_orders_go_at_once(fleet: FleetConfig) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.press("colon", *"takeoff all 1.0", "enter")
        assert client.ordered == ["takeoff mav0,mav1,mav2 1"]


async def test_a_forecast_that_breaks_is_a_sentence_and_no_order(rig: Rig) -> None:
    async def broken(*_: object, **__: object) -> Forecast:
        raise ForecastFailed("The forecast could not be computed (EOFError).")

    rig.oracle.forecast = broken  # type: ignore[method-assign]
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await rig.preview(pilot, "move all 0 1 1")
        assert "could not be computed" in words(rig.app, "answer")
        await pilot.press("enter")
        assert rig.client.ordered == []


async def test_a_computer_on_which_no_process_can_be_started_keeps_its_console(rig: Rig) -> None:
    async def started() -> None:
        raise OSError(24, "Too many open files")

    rig.oracle.start = started  # type: ignore[method-assign]
    async with rig.app.run_test(size=(80, 24)) as pilot:
        rig.hover()
        await pilot.press("colon", "l")
        await pilot.pause(0.1)
        assert rig.app.return_code is None
        await pilot.press("ctrl+l")
        assert rig.client.ordered == ["land mav0,mav1,mav2"]
