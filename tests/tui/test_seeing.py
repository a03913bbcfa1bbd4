"""What the fleet table, the plan and the separation view show, and on which terminals."""

from __future__ import annotations

import itertools
import math
import os
from types import MappingProxyType

import msgspec
import numpy as np
import pytest
from rich.cells import cell_len
from rich.color import Color
from textual.pilot import Pilot

from groundstation.cli import main
from groundstation.fleet import DIRECT_DISARMED, VehicleView, fold
from groundstation.tui import look
from groundstation.tui.app import ConsoleApp
from groundstation.tui.dress import DressedApp, is_ascii_wanted, is_light_wanted, to_ascii
from groundstation.tui.history import History, closest_pairs
from groundstation.tui.screens.vehicle import VehiclePage
from groundstation.tui.widgets.fleet_columns import COLUMNS, choose_columns
from groundstation.tui.widgets.fleet_table import FleetTable
from groundstation.tui.widgets.plan_view import PlanView
from groundstation.tui.widgets.separation import SeparationView
from onboard.bus.schema import Event
from onboard.config import FleetConfig
from tests.tui.fake import telemetry
from tests.tui.scenes import SteadyClient, crowd, fly, ground_and_sky, without

SIZES = [(80, 24), (120, 40), (200, 60)]


def lines(app: ConsoleApp, kind: type) -> list[str]:
    widget = app.screen_stack[0].query_one(kind)
    return [widget.render_line(y).text for y in range(widget.size.height)]


def screen(app: ConsoleApp) -> list[str]:
    """The whole screen as it goes to the terminal."""
    return [strip.text for strip in app.screen._compositor.render_strips()]


async def see(app: ConsoleApp, pilot: Pilot[int]) -> None:
    app.refresh_fleet()
    await pilot.pause()


def table_of(app: ConsoleApp) -> FleetTable:
    return app.screen_stack[0].query_one(FleetTable)


def plan_of(app: ConsoleApp) -> PlanView:
    return app.screen_stack[0].query_one(PlanView)


async def test_the_cursor_stays_on_its_vehicle_when_sorting_moves_the_rows() -> None:
    client = SteadyClient(crowd(6))
    fly(client, 0.0)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("down", "down")
        assert table_of(app).selected == "v002"
        while table_of(app).sort != "bat":
            await pilot.press("s")
        client.hear("v002", battery_frac=0.01, boot_id=8)
        client.clock_ns += 2_000_000_000
        for name in client.fleet.enabled_names[:2]:
            client.hear(name, battery_frac=0.02, boot_id=8)
        await see(app, pilot)
        assert table_of(app).selected == "v002"
        assert table_of(app).cursor == 0
        await pilot.press("S")
        assert table_of(app).selected == "v002"
        assert table_of(app).cursor == 5


async def test_a_filter_shows_some_and_says_what_it_hides_of_the_marked() -> None:
    client = SteadyClient(crowd(12))
    fly(client, 0.0)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("space", "slash", *"v01q", "backspace", "enter")
        assert app.is_running
        assert sum("● flying" in line for line in lines(app, FleetTable)) == 2
        assert table_of(app).marked == ("v000",)
        assert "1 marked, 1 hidden by the filter" in str(table_of(app).border_subtitle)
        assert table_of(app).selected == "v010"
        await pilot.press("escape")
        assert table_of(app).marked == ()
        assert sum("● flying" in line for line in lines(app, FleetTable)) == 12
        await pilot.press("slash", *"nobody", "enter")
        assert any("nobody matches" in line for line in lines(app, FleetTable))
        assert table_of(app).selected is None


@pytest.mark.parametrize(
    ("wish", "names"),
    [
        ("2-3", ("v002", "v003")),
        ("flying !3 !silent", ("v000", "v004")),
        ("silent", ("v005",)),
        ("unready", ("v001",)),
        ("failed", ("v002",)),
        ("waiting", ("v001",)),
        ("[bold", ()),
        ("4-2", ()),
    ],
)
async def test_a_filter_knows_names_places_states_and_conditions(wish: str, names: tuple[str, ...]) -> None:
    client = SteadyClient(crowd(6))
    ground_and_sky(client)
    client.clock_ns += 3_000_000_000
    for name in client.fleet.enabled_names[:5]:
        told = client.state.vehicles[name].telemetry
        assert told is not None
        fields = {key: getattr(told, key) for key in told.__struct_fields__ if key not in ("sequence", "operator",
                  "roles", "vehicle", "schema")}  # fmt: skip
        client.hear(name, **fields)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("slash", *wish, "enter")
        shown = [line for line in lines(app, FleetTable) if line[5:].startswith("v00")]
        assert tuple(line[5:9] for line in shown) == names


async def test_marks_come_by_space_by_range_and_all_at_once() -> None:
    client = SteadyClient(crowd(8))
    fly(client, 0.0)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        table = table_of(app)
        await pilot.press("space", "down", "space")
        assert table.marked == ("v000", "v002")
        await pilot.press("J", "J")
        assert table.marked == ("v000", "v002", "v003", "v004", "v005")
        await pilot.press(*"3-4,v007", "enter")
        assert table.marked == ("v003", "v004", "v007")
        assert table.selected == "v003"
        await pilot.press("asterisk")
        assert len(table.marked) == 8
        assert "ALL marked" in str(table.border_subtitle)
        client.clock_ns += 4_000_000_000
        await see(app, pilot)
        assert len(table.marked) == 8
        client.clock_ns += 1_100_000_000
        await see(app, pilot)
        assert table.marked == ()


@pytest.mark.parametrize("text", ["7-3", "99", "nobody", "[/]", "3-", "1,,2", "1 2", "é"])
async def test_a_wrong_range_marks_nobody_and_says_why(text: str) -> None:
    client = SteadyClient(crowd(8))
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(200, 60)) as pilot:
        await pilot.press("space", "m", *text, "enter")
        assert table_of(app).marked == ("v000",)
        assert "vehicle" in str(table_of(app).border_title)
        await pilot.press("escape")
        assert client.ordered == []
        assert app.is_running


@pytest.mark.parametrize("begin", ["slash", "m", "7"])
async def test_what_is_written_into_the_table_is_no_order_and_no_command(begin: str) -> None:
    client = SteadyClient(crowd(8))
    fly(client, 0.0)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press(begin, *"qw:?Aatz*sSmJKn,.", "tab", "up", "backspace", "f2", "enter")
        await pilot.pause()
        assert client.ordered == []
        assert app.is_running
        assert len(app.screen_stack) == 1
        assert table_of(app).marked == ()


async def test_vehicles_that_vanish_and_come_back_leave_no_mark_and_no_ghost() -> None:
    client = SteadyClient(crowd(4))
    fly(client, 0.0)
    app = ConsoleApp(client.fleet, client)
    whole = client.state
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("down", "space", "up")
        assert table_of(app).marked == ("v001",)
        assert table_of(app).selected == "v001"
        some = {name: view for name, view in whole.vehicles.items() if name != "v001"}
        client.state = msgspec.structs.replace(whole, vehicles=MappingProxyType(some))
        await see(app, pilot)
        assert table_of(app).marked == ()
        assert table_of(app).selected != "v001"
        assert not any("v001" in line[:12] for line in lines(app, FleetTable))
        client.state = whole
        client.hear("v001", boot_id=99)
        await see(app, pilot)
        assert table_of(app).marked == ()
        assert any("v001" in line[:12] for line in lines(app, FleetTable))


@pytest.mark.parametrize("size", [*SIZES, (20, 5), (3, 2)])
async def test_long_and_foreign_names_keep_the_columns_and_stay_apart(size: tuple[int, int]) -> None:
    client = SteadyClient(crowd(4))
    fly(client, 0.0)
    names = [
        "survey_drone_of_the_northern_building_07",
        "survey_drone_of_the_northern_building_08",
        "無人機三號",
        "דרון",
    ]
    client.state = msgspec.structs.replace(client.state, vehicles=MappingProxyType({
        name: msgspec.structs.replace(view, name=name)
        for name, view in zip(names, client.state.vehicles.values(), strict=True)
    }))  # fmt: skip
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=size) as pilot:
        await see(app, pilot)
        table = lines(app, FleetTable)
        assert {cell_len(line) for line in table} <= {table_of(app).size.width}
        assert {cell_len(line) for line in lines(app, PlanView)} <= {plan_of(app).size.width}
        if size[0] >= 80:
            assert any("_07" in line for line in table)
            assert any("_08" in line for line in table)
            column = {
                line.index("● flying") + cell_len(line) - len(line)
                for line in table
                if "無" not in line and "●" in line
            }
            assert len(column) == 1


@pytest.mark.parametrize("size", SIZES)
async def test_the_reason_why_a_vehicle_is_not_ready_is_read_at_every_size(size: tuple[int, int]) -> None:
    client = SteadyClient(crowd(4))
    ground_and_sky(client)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=size) as pilot:
        await see(app, pilot)
        table = "\n".join(lines(app, FleetTable))
        assert "No mocap pose for 2." in table
        assert "PX4 refused to arm" in table
        assert "▲ 29%" in table
        assert "✖ 18%" in table


def test_all_columns_have_room_at_200_and_the_vital_ones_at_60() -> None:
    assert choose_columns(198 - 30)[0] == COLUMNS
    assert choose_columns(198 - 30)[1] >= 24
    vital = {column.title for column in choose_columns(60 - 12)[0]}
    assert {"state", "bat", "z m", "near m"} <= vital
    assert choose_columns(0) == ((), 0)


async def test_a_battery_says_how_long_it_lasts_until_it_has_to_land() -> None:
    client = SteadyClient(crowd(1))
    history = History(land_frac=0.2)
    for second in range(60):
        client.clock_ns += 1_000_000_000
        client.hear("v000", battery_frac=0.8 - 0.1 * second / 60.0, boot_id=3)
        history.add(client.state, client.now_ns())
    assert history.drains["v000"].per_min_frac == pytest.approx(-0.1, rel=0.02)
    assert history.drains["v000"].left_min == pytest.approx((0.7 - 0.2) / 0.1, rel=0.05)
    client.clock_ns += 1_000_000_000
    client.hear("v000", battery_frac=1.0, boot_id=3)
    history.add(client.state, client.now_ns())
    assert "v000" not in history.drains, "another battery has another trend"


def test_the_closest_pairs_are_those_of_a_plain_search_and_say_when_they_meet() -> None:
    rng = np.random.default_rng(5)
    known = []
    for index in range(30):
        told = telemetry(f"v{index:02d}", is_airborne=bool(index % 3), position_enu_m=tuple(rng.uniform(-9, 9, 3)),
                         velocity_enu_m_s=tuple(rng.uniform(-1, 1, 3)))  # fmt: skip
        known.append((VehicleView(told.vehicle, told, 0), told.position_enu_m))
    pairs = closest_pairs(known, most=10)
    plain = sorted(
        math.dist(p[:2], q[:2]) for (a, p), (b, q) in itertools.combinations(known, 2) if a.is_airborne or b.is_airborne
    )
    assert [pair.distance_m for pair in pairs] == pytest.approx(plain[:10])
    views = {view.name: view.telemetry for view, _ in known}
    for pair in pairs:
        one, two = views[pair.first], views[pair.second]
        assert one is not None
        assert two is not None
        gap = np.subtract(two.position_enu_m, one.position_enu_m)[:2]
        drift = np.subtract(two.velocity_enu_m_s, one.velocity_enu_m_s)[:2]
        times_s = np.linspace(0.0, 60.0, 60_001)
        distances = np.hypot(*(gap[:, None] + drift[:, None] * times_s))
        if math.isfinite(pair.approach_s) and pair.approach_s < 59.0:
            assert times_s[distances.argmin()] == pytest.approx(pair.approach_s, abs=2e-3)
            assert distances.min() == pytest.approx(pair.approach_m, abs=1e-3)
        elif math.isinf(pair.approach_s):
            assert distances.argmin() == 0


async def test_separation_shows_pairs_the_time_to_the_closest_approach_and_the_timing(fleet: FleetConfig) -> None:
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        client.clock_ns += 2_000_000_000
        client.hear("mav0", position_enu_m=(-2.0, 0.0, 1.0), velocity_enu_m_s=(1.0, 0.0, 0.0))
        client.hear("mav1", position_enu_m=(2.0, 0.5, 1.0), velocity_enu_m_s=(-1.0, 0.0, 0.0))
        await see(app, pilot)
        shown = "\n".join(lines(app, SeparationView))
        assert "4.03 m" in shown
        assert "▲ 0.50 m in 2.0 s" in shown
        assert "loop p99" in shown
        assert "21 ms mav0" in shown
        assert "20 ms mav0" in shown
        assert "0.80" in shown


async def test_the_plan_is_north_up_and_zooms_pans_and_follows(fleet: FleetConfig) -> None:
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)

    def place(digit: str) -> tuple[int, int]:
        return next((y, line.index(digit)) for y, line in enumerate(lines(app, PlanView)) if digit in line)

    async with app.run_test(size=(120, 40)) as pilot:
        client.hear("mav0", position_enu_m=(-2.0, -2.0, 1.0))
        client.hear("mav1", position_enu_m=(2.0, 2.0, 2.5))
        await see(app, pilot)
        assert place("2.5m")[0] < place("1.0m")[0]
        assert place("2.5m")[1] > place("1.0m")[1]
        before = place("2.5m")
        plan_of(app).focus()
        await pilot.press("up")
        assert place("2.5m")[0] > before[0]
        await pilot.press("right")
        assert place("2.5m")[1] < before[1]
        await pilot.press("f")
        assert "follows mav0" in str(plan_of(app).border_title)
        spot = place("[0]")
        client.hear("mav0", position_enu_m=(1.0, 1.0, 1.0))
        client.clock_ns += 200_000_000
        await see(app, pilot)
        assert place("[0]") == spot
        await pilot.press("f")
        assert "follows the fleet" in str(plan_of(app).border_title)
        await pilot.press("0")
        for factor in [1.5] * 30 + [0.6] * 60:
            plan_of(app).change_zoom(factor)
            plan_of(app).action_pan(-1, 1)
        await see(app, pilot)
        assert app.is_running


async def test_the_plan_tells_silence_nearness_and_avoidance_by_signs(fleet: FleetConfig) -> None:
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        client.hear("mav2", position_enu_m=(-2.0, 1.0, 1.0))
        client.clock_ns += 2_000_000_000
        client.hear(
            "mav0", position_enu_m=(0.0, 0.0, 1.0), law_status="saturated", avoids="mav1", nearest_vehicle="mav2"
        )
        client.hear("mav1", position_enu_m=(0.7, 0.0, 1.0))
        await see(app, pilot)
        plan = "\n".join(lines(app, PlanView))
        assert "2?" in plan
        assert "[0]!" in plan
        assert "1!" in plan
        assert "→" in plan
        client.hear(
            "mav0", position_enu_m=(0.0, 0.0, 1.0), law_status="saturated", avoids="mav2", nearest_vehicle="mav1"
        )
        client.clock_ns += 200_000_000
        await see(app, pilot)
        assert "↖" in "\n".join(lines(app, PlanView))


@pytest.mark.parametrize("size", [(80, 24), (160, 40)])
async def test_what_px4_says_past_a_silent_agent_stands_in_place_of_what_was_heard_in_the_air(
    fleet: FleetConfig, size: tuple[int, int]
) -> None:
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=size) as pilot:
        client.hear("mav0", state="flying", position_enu_m=(0.4, -0.3, 1.23), is_armed=True)
        client.clock_ns += int(3e9)
        await see(app, pilot)
        assert "NO TELEM 3.0 s" in lines(app, FleetTable)[1]
        told = Event(vehicle="mav0", stamp_ns=1, severity="warning", code=DIRECT_DISARMED, sentence="It is disarmed.")
        client.state = fold(client.state, told, client.now_ns())
        await see(app, pilot)
        row = lines(app, FleetTable)[1]
        assert "NO TELEM 3.0 s" in row
        assert "PX4 says disarmed, last heard at +0.40 -0.30" in row
        assert "ARMED" not in row
        assert "1.23" not in row
        await pilot.press("enter")
        await pilot.pause()
        page = app.screen.query_one(VehiclePage)
        assert "PX4 says disarmed" in str(page.border_title)
        assert "ARMED" not in "".join(page.render_line(y).text for y in range(page.size.height))
        await pilot.press("escape", "slash", *"armed", "enter")
        await see(app, pilot)
        assert "nobody matches" in lines(app, FleetTable)[1]
        client.hear("mav0", state="flying", is_armed=True)
        await see(app, pilot)
        assert "flying" in lines(app, FleetTable)[1], "the agent is back, and knows better"


async def test_an_obstacle_stands_in_the_plan_with_its_name() -> None:
    client = SteadyClient(crowd(4, side_m=8.0))
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("tab", "z")
        await see(app, pilot)
        assert "wall" in "\n".join(lines(app, PlanView))
        assert plan_of(app).size.width > 110
        await pilot.press("escape")
        await pilot.pause()
        assert plan_of(app).size.width < 80
        assert plan_of(app).has_focus
        await pilot.press("escape")
        assert table_of(app).has_focus


async def test_what_stands_still_is_not_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    client = SteadyClient(crowd(30))
    fly(client, 0.0)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await see(app, pilot)
        drawn: list[object] = []
        for kind in (FleetTable, PlanView, SeparationView):
            monkeypatch.setattr(kind, "refresh", lambda self, *regions, **_: drawn.append(regions))
        app.refresh_fleet()
        app.refresh_fleet()
        assert drawn == []
        client.hear("v003", position_enu_m=(0.0, 0.0, 2.0), boot_id=9)
        table_of(app).show(client.state, client.now_ns())
        assert len(drawn) == 1


@pytest.mark.parametrize("size", SIZES[:2])
async def test_on_a_terminal_without_unicode_every_character_is_ascii_in_its_place(
    size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    client = SteadyClient(crowd(12))
    ground_and_sky(client)
    pictures = []
    for wish in ("0", "1"):
        monkeypatch.setenv("COVEY_ASCII", wish)
        app = ConsoleApp(client.fleet, client)
        async with app.run_test(size=size) as pilot:
            app.time_text = lambda _ns: "12:00:00"  # type: ignore[method-assign]
            await see(app, pilot)
            pictures.append(screen(app))
            await pilot.press("question_mark")
            await pilot.pause()
            if wish == "1":
                assert all(line.isascii() and line.isprintable() for line in screen(app))
    unicode, ascii_ = pictures
    assert any(not line.isascii() for line in unicode)
    assert all(line.isascii() and line.isprintable() for line in ascii_)
    assert [cell_len(line) for line in ascii_] == [cell_len(line) for line in unicode]
    assert any("* flying" in line for line in ascii_)


@pytest.mark.parametrize(
    ("environ", "is_ascii"),
    [
        ({}, False),
        ({"LANG": "en_US.UTF-8"}, False),
        ({"LANG": "de_DE.utf8"}, False),
        ({"LANG": "C"}, True),
        ({"LC_ALL": "POSIX", "LANG": "en_US.UTF-8"}, True),
        ({"LANG": "en_US.ISO-8859-1"}, True),
        ({"LANG": "C", "LC_CTYPE": "C.UTF-8"}, False),
        ({"COVEY_ASCII": "1", "LANG": "en_US.UTF-8"}, True),
        ({"COVEY_ASCII": "0", "LANG": "C"}, False),
    ],
)
def test_ascii_follows_the_locale_unless_asked_for(environ: dict[str, str], is_ascii: bool) -> None:
    assert is_ascii_wanted(environ, is_utf8_forced=False) == is_ascii


def test_a_locale_that_python_wrote_itself_is_nobodys_wish() -> None:
    assert is_ascii_wanted({"LANG": "C", "LC_CTYPE": "C.UTF-8"}, is_utf8_forced=True)
    assert not is_ascii_wanted({"LC_CTYPE": "C.UTF-8"}, is_utf8_forced=True)


def test_every_character_has_an_ascii_likeness_of_its_width() -> None:
    for code in [*range(0x20, 0x3100), *range(0x4E00, 0x4E40), *range(0x1F600, 0x1F610)]:
        char = chr(code)
        if char.isprintable():
            plain = to_ascii(char)
            assert plain.isascii()
            assert cell_len(plain) == cell_len(char), hex(code)


async def test_without_colour_no_colour_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    client = SteadyClient(crowd(12))
    ground_and_sky(client)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await see(app, pilot)
        for strip in app.screen._compositor.render_strips():
            for segment in strip:
                for colour in (segment.style.color, segment.style.bgcolor) if segment.style else ():
                    assert colour is None or colour.is_default
        assert sum("▌" in line for line in lines(app, FleetTable)) == 1, "the cursor is a sign"


def _luminance(colour: str) -> float:
    parts = Color.parse(colour).get_truecolor().normalized
    red, green, blue = (part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def _contrast(one: str, two: str) -> float:
    high, low = sorted((_luminance(one), _luminance(two)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_every_colour_is_read_on_its_ground_dark_and_light() -> None:
    written = {look.TEXT, look.FAINT, look.GOOD, look.WARN, look.BAD, look.KILL, look.CALM, *look.VEHICLE_COLOURS,
               *look.HEIGHT_COLOURS}  # fmt: skip
    for colour in written:
        assert _contrast(colour, look.GROUND) >= 4.5, colour
        assert _contrast(look.LIGHT[colour], look.LIGHT[look.GROUND]) >= 4.5, colour


@pytest.mark.parametrize(
    ("environ", "is_light"),
    [({}, False), ({"COLORFGBG": "0;15"}, True), ({"COLORFGBG": "15;0"}, False), ({"COLORFGBG": "0;default;15"}, True),
     ({"COLORFGBG": "0;15", "COVEY_THEME": "dark"}, False), ({"COVEY_THEME": "light"}, True),
     ({"COLORFGBG": ";"}, False)],
)  # fmt: skip
def test_the_ground_of_the_terminal_is_told_by_its_environment(environ: dict[str, str], is_light: bool) -> None:
    assert is_light_wanted(environ) == is_light


async def test_t_changes_between_dark_and_light(fleet: FleetConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("COLORFGBG", raising=False)
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)

    def grounds() -> set[str]:
        return {
            segment.style.bgcolor.get_truecolor().hex
            for strip in app.screen._compositor.render_strips()
            for segment in strip
            if segment.style and segment.style.bgcolor
        }

    async with app.run_test(size=(80, 24)) as pilot:
        await see(app, pilot)
        assert max(map(_luminance, grounds())) < 0.1
        await pilot.press("t")
        await pilot.pause()
        assert min(map(_luminance, grounds())) > 0.6
        await pilot.press("t")
        await pilot.pause()
        assert max(map(_luminance, grounds())) < 0.1


async def test_a_fleet_of_none_and_a_tiny_terminal_are_drawn(fleet: FleetConfig) -> None:
    empty = without(fleet, *fleet.enabled_names)
    app = ConsoleApp(empty, SteadyClient(empty))
    async with app.run_test(size=(80, 24)) as pilot:
        await see(app, pilot)
        assert any("no vehicles" in line for line in lines(app, FleetTable))
        for key in ("down", "space", "asterisk", "s", "f", "plus", "enter"):
            await pilot.press(key)
        for size in [(20, 5), (5, 2), (1, 1), (80, 24)]:
            await pilot.resize_terminal(*size)
            await see(app, pilot)
        assert any("no vehicles" in line for line in lines(app, FleetTable))


@pytest.mark.parametrize("size", [(20, 5), (20, 24), (80, 5), (30, 8)])
async def test_on_a_tiny_terminal_the_worst_alarm_and_how_to_land_all_stay(
    fleet: FleetConfig, size: tuple[int, int]
) -> None:
    client = SteadyClient(fleet)
    client.circle(1.0)
    client.hear("mav1", battery_frac=0.01)
    app = ConsoleApp(fleet, client, has_preview=False)
    async with app.run_test(size=(80, 24)) as pilot:
        await pilot.resize_terminal(*size)
        await see(app, pilot)
        await see(app, pilot)
        seen = screen(app)
        assert any("✖ mav1" in line or "✖ Battery" in line for line in seen)
        assert any("l LAND ALL" in line for line in seen)
        assert sum(" mav" in line[:10] for line in seen) >= 2
        await pilot.press("colon", *"hodl", "enter")
        await see(app, pilot)
        seen = screen(app)
        assert any("'hodl' is no" in line for line in seen)
        assert any(line.startswith(" : hodl") for line in seen)
        assert any("l LAND ALL" in line for line in seen)
        await pilot.press("escape")
        await pilot.press("m", "1", ",")
        await see(app, pilot)
        assert any("mark: 1,▏" in line for line in screen(app))


async def test_after_a_tiny_size_everything_is_as_before() -> None:
    client = SteadyClient(crowd(8))
    ground_and_sky(client)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        await see(app, pilot)
        before = screen(app)
        for size in [(20, 5), (80, 24)]:
            await pilot.resize_terminal(*size)
            await see(app, pilot)
        assert screen(app) == before


async def test_a_hundred_rows_scroll_and_the_heading_stays() -> None:
    client = SteadyClient(crowd(100))
    fly(client, 0.0)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        await see(app, pilot)
        for key, name in (("end", "v099"), ("home", "v000"), ("up", "v000")):
            await pilot.press(key)
            await pilot.pause()
            table = lines(app, FleetTable)
            assert "state" in table[0]
            assert any(line.startswith("▌") and name in line for line in table)
        table_of(app).action_cursor(30)
        await pilot.pause()
        assert any(line.startswith("▌") and "v030" in line for line in lines(app, FleetTable))


def test_the_process_environment_is_what_an_app_looks_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "COVEY_ASCII", "1")
    assert DressedApp().is_ascii


@pytest.mark.parametrize("words", [["--ascii", "--version"], ["tui", "--ascii", "--help"]])
def test_the_flag_stands_anywhere_on_the_command_line(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COVEY_ASCII", "0")
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 0
    assert os.environ["COVEY_ASCII"] == "1"
