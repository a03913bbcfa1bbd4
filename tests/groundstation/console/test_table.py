"""The fleet table: sorting, filters, marks, names, columns, batteries, silence."""

from __future__ import annotations

from types import MappingProxyType
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace
from rich.cells import cell_len

from groundstation.console import theme
from groundstation.console.app import ConsoleApp
from groundstation.console.history import History
from groundstation.console.screens.vehicle_screen import VehicleBlocks
from groundstation.console.widgets.fleet_columns import COLUMNS, VehicleRow, fit_columns, reason
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.plan_view import PlanView
from groundstation.fleet.satellite_words import satellite_words
from groundstation.fleet.state import DIRECT_DISARMED, VehicleView, fold
from onboard.bus.schema import Event, Telemetry
from onboard.config.fleet import CorrectionsConfig, FleetConfig
from onboard.safety.failsafe_table import Condition
from tests.groundstation.console.fake import telemetry
from tests.groundstation.console.rig import Rig
from tests.groundstation.console.scenes import SteadyClient, crowd, fly, ground_and_sky
from tests.groundstation.console.seeing import SIZES, lines, plan_of, see, table_of


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

        await pilot.press("slash", *"nobody", "enter", "asterisk")
        assert table_of(app).marked == ("v000",), "a star means those that are shown"
        await pilot.press("slash", "ctrl+u", *"v01", "enter")
        assert "1 marked, 1 hidden by the filter" in str(table_of(app).border_subtitle)
        assert table_of(app).selected == "v010"
        await pilot.press("escape")
        assert table_of(app).marked == ()
        assert sum("● flying" in line for line in lines(app, FleetTable)) == 12

        await pilot.press("slash", *"nobody", "enter")
        assert any("nobody matches" in line for line in lines(app, FleetTable))
        assert table_of(app).selected is None


async def test_the_cursor_stays_on_a_vehicle_that_the_filter_does_not_show_any_more() -> None:
    client = SteadyClient(crowd(6))
    fly(client, 0.0)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("slash", *"flying", "enter", "down", "down")
        assert table_of(app).selected == "v002"

        client.clock_ns += 2_000_000_000
        fly(client, 2.0)
        client.hear("v002", state="landing")
        await see(app, pilot)
        assert table_of(app).selected == "v002", "the next order would reach another vehicle"
        assert table_of(app).row_count == 6

        await pilot.press("down")
        await see(app, pilot)
        assert table_of(app).selected == "v003"
        assert table_of(app).row_count == 5

        await pilot.press("slash", "ctrl+u", *"v004", "enter")
        assert table_of(app).selected == "v004", "a filter that is written anew moves the cursor"


async def test_a_filter_knows_names_numbers_states_and_conditions() -> None:
    client = SteadyClient(crowd(6))
    ground_and_sky(client)
    client.clock_ns += 3_000_000_000
    for name in client.fleet.enabled_names[:5]:
        last = client.state.vehicles[name].telemetry
        assert last is not None
        fields = {
            key: getattr(last, key)
            for key in last.__struct_fields__
            if key not in ("sequence", "operator", "roles", "vehicle", "schema")
        }
        client.hear(name, **fields)

    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        for filter_text, names in [
            ("2-3", ("v002", "v003")),
            ("flying !3 !silent", ("v000", "v004")),
            ("silent", ("v005",)),
            ("unready", ("v001",)),
            ("failed", ("v002",)),
            ("waiting", ("v001",)),
            ("[bold", ()),
            ("4-2", ()),
        ]:
            await pilot.press("escape", "slash", *filter_text, "enter")
            shown = [line for line in lines(app, FleetTable) if line[5:].startswith("v00")]
            assert tuple(line[5:9] for line in shown) == names, filter_text


async def test_a_vehicle_has_the_number_by_which_orders_know_it_though_others_are_disabled(
    fleet: FleetConfig,
) -> None:
    off = replace(fleet.vehicles["mav0"], enabled=False)
    rig = Rig(replace(fleet, vehicles={**fleet.vehicles, "mav0": off}))
    assert rig.client.fleet.select("1") == ("mav1",)

    async with rig.app.run_test(size=(120, 40)) as pilot:
        for name, east_m in (("mav1", -1.0), ("mav2", 1.0)):
            spot = (east_m, 0.0, 1.0)
            rig.client.hear(name, position_enu_m=spot, goal_position_enu_m=spot)
        await see(rig.app, pilot)
        shown = [line.split()[:2] for line in lines(rig.app, FleetTable) if "flying" in line]
        assert shown == [["▌", "1"], ["2", "mav2"]]
        drawn = "\n".join(lines(rig.app, PlanView))
        assert "[1]" in drawn
        assert "[0]" not in drawn

        await pilot.press("2", "enter")
        assert table_of(rig.app).marked == ("mav2",)
        await pilot.press("escape", "slash", *"2-2", "enter")
        assert [view.split()[1] for view in lines(rig.app, FleetTable) if "flying" in view] == ["2"]

        await rig.preview(pilot, "move 1-2 0 1 1")
        await see(rig.app, pilot)
        assert "1 mav1" in rig.screen_text
        assert "2 mav2" in rig.screen_text


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


async def test_an_order_that_is_begun_keeps_all_marked_for_five_seconds_more() -> None:
    client = SteadyClient(crowd(8))
    fly(client, 0.0)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        table = table_of(app)
        await see(app, pilot)
        await pilot.press("asterisk")
        assert len(table.marked) == 8
        client.clock_ns += 4_000_000_000
        await see(app, pilot)
        await pilot.press("f4")  # move

        client.clock_ns += 4_000_000_000
        await see(app, pilot)
        assert len(table.marked) == 8

        client.clock_ns += 1_100_000_000
        await see(app, pilot)
        assert table.marked == ()


async def test_a_wrong_range_marks_nobody_and_says_why() -> None:
    client = SteadyClient(crowd(8))
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(200, 60)) as pilot:
        await pilot.press("space")
        for text in ["7-3", "99", "nobody", "[/]", "3-", "1,,2", "1 2", "é"]:
            await pilot.press("m", *text, "enter")
            assert table_of(app).marked == ("v000",), text
            assert "vehicle" in str(table_of(app).border_title), text
            await pilot.press("escape")
        assert client.ordered == []
        assert app.is_running


async def test_letters_of_a_filter_or_of_marks_are_no_orders_and_no_commands() -> None:
    client = SteadyClient(crowd(8))
    fly(client, 0.0)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        for begin in ["slash", "m", "7"]:
            await pilot.press(begin, *"qw:?Aatz*sSmJKn,.", "tab", "up", "backspace", "f2", "enter")
            await pilot.pause()
            assert client.ordered == [], begin
            assert app.is_running, begin
            assert len(app.screen_stack) == 1, begin
            assert table_of(app).marked == (), begin
            await pilot.press("escape", "escape")


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
async def test_long_and_foreign_names_keep_the_columns_and_stay_apart(
    size: tuple[int, int],
) -> None:
    client = SteadyClient(crowd(4))
    fly(client, 0.0)
    names = [
        "survey_drone_of_the_northern_building_07",
        "survey_drone_of_the_northern_building_08",
        "無人機三號",
        "דרון",
    ]
    client.state = msgspec.structs.replace(
        client.state,
        vehicles=MappingProxyType(
            {
                name: msgspec.structs.replace(view, name=name)
                for name, view in zip(names, client.state.vehicles.values(), strict=True)
            }
        ),
    )
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


async def test_the_reason_why_a_vehicle_is_not_ready_is_read_at_every_size() -> None:
    client = SteadyClient(crowd(4))
    ground_and_sky(client)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=SIZES[0]) as pilot:
        for size in SIZES:
            await pilot.resize_terminal(*size)
            await see(app, pilot)
            table = "\n".join(lines(app, FleetTable))
            for words in ("No mocap pose for 2.", "PX4 refused to arm", "▲ 29%", "✖ 18%"):
                assert words in table, (size, words)


def test_all_columns_have_room_at_200_and_the_vital_ones_at_60() -> None:
    everywhere = tuple(column for column in COLUMNS if not column.of_corrections)
    assert fit_columns(198 - 30)[0] == everywhere
    assert fit_columns(198 - 30)[1] >= 24
    assert fit_columns(230, has_corrections=True)[0] == COLUMNS

    vital = {column.title for column in fit_columns(60 - 12)[0]}
    assert {"state", "bat", "z m", "near m"} <= vital
    assert fit_columns(0) == ((), 0)


def _row(**changes: object) -> VehicleRow:
    told = telemetry("mav0", **changes)
    return VehicleRow(
        view=VehicleView("mav0", told),
        telemetry=told,
        fleet=crowd(1),
        drain=None,
        age_s=0.1,
        is_stale=False,
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"state": "holding", "reason": "ordered"}, "stands in for mav2, ordered"),
        ({"state": "ready", "reason": ""}, "stands in for mav2"),
        ({"follows": "mav1"}, "stands in for mav2, follows mav1"),
        ({"state": "failed", "reason": "It fell."}, "It fell."),
        ({"is_airborne": False, "not_ready": ("No pose.",)}, "No pose."),
    ],
)
def test_a_row_says_for_whom_a_vehicle_stands_in(changes: dict[str, object], words: str) -> None:
    text, _ = reason(_row(stands_in_for="mav2", **changes))
    assert text == words


@pytest.mark.parametrize(
    ("state", "cell"),
    [
        ("flying", ("■ paused", theme.WARN)),
        ("holding", ("■ paused", theme.WARN)),
        ("landing", ("▼ landing", theme.WARN)),
        ("failed", ("✖ failed", theme.BAD)),
    ],
)
def test_a_pause_is_read_in_the_state_which_every_terminal_shows(
    state: str, cell: tuple[str, str]
) -> None:
    (column,) = [column for column in COLUMNS if column.title == "state"]
    assert column.cell(_row(state=state, follows="mav1", is_path_paused=True)) == cell


def test_a_fleet_with_corrections_shows_fix_age_and_base_and_marks_what_is_wrong() -> None:
    fleet = replace(crowd(1), corrections=CorrectionsConfig(source="mock", fix="rtk_fixed"))
    told = telemetry_of(
        fleet,
        fix="RTK fixed",
        satellites=21,
        corrections_age_s=0.64,
        base_id=1234,
        base_distance_m=420.0,
    )
    assert satellite_cells(fleet, told) == [" RTK fixed 21", "0.6", "1234 420 m"]
    fallen_back = replace(
        told,
        fix="RTK float",
        corrections_age_s=12.0,
        base_distance_m=2345.6,
        conditions=(Condition.FIX_FELL_BACK.value, Condition.BASE_FAULT.value),
    )
    assert satellite_cells(fleet, fallen_back) == ["▲RTK float 21", "▲12.0", "▲1234 2.3 km"]
    # what nobody has told, and what no receiver can say
    assert satellite_cells(fleet, telemetry_of(fleet)) == ["-", "none", "-"]
    absurd = replace(told, fix="x" * 99, satellites=9999, base_id=10**9, base_distance_m=1e12)
    widths = [column.width for column in COLUMNS if column.of_corrections]
    for cell, width in zip(satellite_cells(fleet, absurd), widths, strict=True):
        assert cell_len(cell) <= width

    assert satellite_words(told) == (
        "RTK fixed, 21 satellites, corrections 0.6 s old, base 1234 at 420 m"
    )
    assert satellite_words(telemetry_of(fleet)) == ""


def telemetry_of(fleet: FleetConfig, **values: Any) -> Telemetry:
    client = SteadyClient(fleet)
    fly(client, 0.0)
    last = client.state.vehicles[fleet.enabled_names[0]].telemetry
    assert last is not None
    return replace(last, **values)


def satellite_cells(fleet: FleetConfig, told: Telemetry) -> list[str]:
    """The texts of the columns about corrections."""
    view = VehicleView(told.vehicle)
    row = VehicleRow(view=view, telemetry=told, fleet=fleet, drain=None, age_s=0.1, is_stale=False)
    return [column.cell(row)[0] for column in COLUMNS if column.of_corrections]


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


async def test_the_time_that_a_battery_lasts_does_not_count_the_time_on_the_ground() -> None:
    client = SteadyClient(crowd(1))
    history = History(land_frac=0.2)
    for second in range(150):
        flown_s = max(0, second - 120)
        charge_frac = 1.0 - 0.2 * flown_s / 60.0
        client.clock_ns += 1_000_000_000
        client.hear("v000", battery_frac=charge_frac, boot_id=3, is_airborne=flown_s > 0)
        history.add(client.state, client.now_ns())

    assert history.drains["v000"].left_min == pytest.approx((charge_frac - 0.2) / 0.2, rel=0.05)


@pytest.mark.parametrize("size", [(80, 24), (160, 40)])
async def test_px4s_own_disarmed_report_replaces_the_old_values_of_a_silent_agent(
    fleet: FleetConfig, size: tuple[int, int]
) -> None:
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=size) as pilot:
        client.hear("mav0", state="flying", position_enu_m=(0.4, -0.3, 1.23), is_armed=True)
        client.clock_ns += int(3e9)
        await see(app, pilot)
        assert "NO TELEM 3.0 s" in lines(app, FleetTable)[1]

        disarmed = Event(
            vehicle="mav0",
            stamp_ns=1,
            severity="warning",
            code=DIRECT_DISARMED,
            sentence="It is disarmed.",
        )
        client.state = fold(client.state, disarmed, client.now_ns())
        await see(app, pilot)

        row = lines(app, FleetTable)[1]
        assert "NO TELEM 3.0 s" in row
        assert "PX4 says disarmed, last heard at +0.40 -0.30" in row
        assert "ARMED" not in row
        assert "1.23" not in row

        await pilot.press("enter")
        await pilot.pause()
        page = app.screen.query_one(VehicleBlocks)
        assert "PX4 says disarmed" in str(page.border_title)
        assert "ARMED" not in "".join(page.render_line(y).text for y in range(page.size.height))

        await pilot.press("escape", "slash", *"armed", "enter")
        await see(app, pilot)
        assert "nobody matches" in lines(app, FleetTable)[1]

        client.clock_ns += 1_000_000_000
        client.hear("mav0", state="flying", is_armed=True)
        await see(app, pilot)
        assert "flying" in lines(app, FleetTable)[1], "the agent is back, and knows better"


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
