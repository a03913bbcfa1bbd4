"""What the plan and the separation view show."""

from __future__ import annotations

import itertools
import math

import msgspec
import numpy as np
import pytest

from groundstation.console.app import ConsoleApp
from groundstation.console.history import closest_pairs
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.plan_view import PlanView
from groundstation.console.widgets.separation_view import SeparationView
from groundstation.fleet.state import VehicleView, fold
from onboard.bus.schema import MocapPose, MocapPoses
from onboard.config.fleet import FleetConfig, Person
from tests.groundstation.console.fake import telemetry
from tests.groundstation.console.scenes import SteadyClient, crowd, fly, named_by_numbers
from tests.groundstation.console.seeing import lines, plan_of, see, table_of


def test_the_closest_pairs_are_those_of_a_plain_search_and_say_when_they_meet() -> None:
    rng = np.random.default_rng(5)
    known = []
    for index in range(30):
        heard = telemetry(
            f"v{index:02d}",
            is_airborne=bool(index % 3),
            position_enu_m=tuple(rng.uniform(-9, 9, 3)),
            velocity_enu_m_s=tuple(rng.uniform(-1, 1, 3)),
        )
        known.append((VehicleView(heard.vehicle, heard, 0), heard.position_enu_m))

    pairs = closest_pairs(known, most=10)

    plain = sorted(
        math.dist(p[:2], q[:2])
        for (a, p), (b, q) in itertools.combinations(known, 2)
        if a.is_airborne or b.is_airborne
    )
    assert [pair.distance_m for pair in pairs] == pytest.approx(plain[:10])

    views = {view.name: view.telemetry for view, _ in known}
    for pair in pairs:
        one = views[pair.first]
        two = views[pair.second]
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


@pytest.mark.parametrize(
    ("speed_m_s", "expected_s"), [(0.04, math.nan), (0.06, math.inf), (-0.5, 4.0)]
)
def test_two_that_hover_are_neither_parting_nor_approaching(
    speed_m_s: float, expected_s: float
) -> None:
    at_rest = (0.0, 0.0, 0.0)
    still = telemetry("a", position_enu_m=(0.0, 0.0, 1.0), velocity_enu_m_s=at_rest)
    other = telemetry(
        "b",
        is_airborne=True,
        position_enu_m=(2.0, 0.0, 1.0),
        velocity_enu_m_s=(speed_m_s, 0.0, 0.0),
    )
    known = [(VehicleView(one.vehicle, one, 0), one.position_enu_m) for one in (still, other)]
    (pair,) = closest_pairs(known)
    assert pair.approach_s == pytest.approx(expected_s, nan_ok=True)


async def test_separation_shows_pairs_the_time_to_the_closest_approach_and_the_timing(
    fleet: FleetConfig,
) -> None:
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


async def test_vehicles_named_by_numbers_have_no_other_numbers(fleet: FleetConfig) -> None:
    named = named_by_numbers(fleet)
    client = SteadyClient(named)
    app = ConsoleApp(named, client)
    async with app.run_test(size=(240, 60)) as pilot:
        for east_m, name in enumerate(named.vehicles):
            client.hear(name, state="ready", is_airborne=False, position_enu_m=(east_m, 0.0, 0.0))
        client.hear("2", position_enu_m=(0.0, 0.0, 1.0), state="flying", is_airborne=True)
        await see(app, pilot)

        rows = [line.split() for line in lines(app, FleetTable)]
        assert ["2", "●", "flying"] in [row[1:4] for row in rows], "after the cursor"
        assert ["1", "○", "ready"] in [row[:3] for row in rows]
        plan = "\n".join(lines(app, PlanView))
        assert "[2] 1.0m" in plan, "it is under the cursor"
        assert "[0]" not in plan

        await pilot.press("slash", *"1-2", "enter")
        await see(app, pilot)
        shown = [line for line in lines(app, FleetTable) if "ready" in line or "flying" in line]
        assert len(shown) == 2
        assert not any(line.split()[0] == "0" for line in shown)


async def test_of_vehicles_in_one_place_the_most_important_number_is_shown(
    fleet: FleetConfig,
) -> None:
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(80, 24)) as pilot:
        for name, east_m in (("mav0", 0.0), ("mav1", 0.2), ("mav2", 0.3)):
            client.hear(name, position_enu_m=(east_m, 0.0, 0.0), is_airborne=False)
        for keys, shown in (((), "[0]"), (("down",), "[1]"), (("down",), "[2]")):
            await pilot.press(*keys)
            await see(app, pilot)
            assert shown in "\n".join(lines(app, PlanView))

        client.hear("mav2", position_enu_m=(2.0, 2.0, 0.0))
        await pilot.press("1", "enter", "down")  # the cursor is on mav2
        await see(app, pilot)
        assert "✓1" in "\n".join(lines(app, PlanView)), "a marked one before another"


async def test_the_plan_is_north_up_and_zooms_pans_and_follows(fleet: FleetConfig) -> None:
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)

    def cell_of(digit: str) -> tuple[int, int]:
        return next(
            (y, line.index(digit)) for y, line in enumerate(lines(app, PlanView)) if digit in line
        )

    async with app.run_test(size=(120, 40)) as pilot:
        client.hear("mav0", position_enu_m=(-2.0, -2.0, 1.0))
        client.hear("mav1", position_enu_m=(2.0, 2.0, 2.5))
        await see(app, pilot)

        assert cell_of("2.5m")[0] < cell_of("1.0m")[0]
        assert cell_of("2.5m")[1] > cell_of("1.0m")[1]

        before = cell_of("2.5m")
        plan_of(app).focus()
        await pilot.press("up")
        assert cell_of("2.5m")[0] > before[0]

        await pilot.press("right")
        assert cell_of("2.5m")[1] < before[1]

        await pilot.press("f")
        assert "follows mav0" in str(plan_of(app).border_title)

        before_zoom = cell_of("[0]")
        client.hear("mav0", position_enu_m=(1.0, 1.0, 1.0))
        client.clock_ns += 200_000_000
        await see(app, pilot)
        assert cell_of("[0]") == before_zoom

        await pilot.press("f")
        assert "follows the fleet" in str(plan_of(app).border_title)

        await pilot.press("0")
        for factor in [1.5] * 30 + [0.6] * 60:
            plan_of(app).change_zoom(factor)
            plan_of(app).action_pan(-1, 1)

        await see(app, pilot)
        assert app.is_running


async def test_the_plan_keeps_its_scale_when_a_vehicle_comes_back_into_the_fence(
    fleet: FleetConfig,
) -> None:
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)
    west_m = fleet.fleet.geofence_m.x[0]

    async with app.run_test(size=(120, 40)) as pilot:
        columns = []
        for x_m in (west_m - 6.0, 0.0, 0.0, 0.0, 0.0):
            client.clock_ns += 1_000_000_000
            client.hear("mav0", position_enu_m=(x_m, 0.0, 1.0))
            client.hear("mav1", position_enu_m=(2.0, 2.0, 2.5))
            await see(app, pilot)
            columns.append(
                next(line.index("2.5m") for line in lines(app, PlanView) if "2.5m" in line)
            )
        assert len(set(columns)) == 1


async def test_the_plan_shows_silence_nearness_and_avoidance_by_signs(fleet: FleetConfig) -> None:
    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        client.hear("mav2", position_enu_m=(-2.0, 1.0, 1.0))
        client.clock_ns += 2_000_000_000
        client.hear(
            "mav0",
            position_enu_m=(0.0, 0.0, 1.0),
            law_status="saturated",
            avoids="mav1",
            nearest_vehicle="mav2",
        )

        client.hear("mav1", position_enu_m=(0.7, 0.0, 1.0))
        await see(app, pilot)

        plan = "\n".join(lines(app, PlanView))
        assert "2?" in plan
        assert "[0]!" in plan
        assert "1!" in plan
        assert "→" in plan

        client.hear(
            "mav0",
            position_enu_m=(0.0, 0.0, 1.0),
            law_status="saturated",
            avoids="mav2",
            nearest_vehicle="mav1",
        )

        client.clock_ns += 200_000_000
        await see(app, pilot)
        assert "↖" in "\n".join(lines(app, PlanView))

        # held back by an obstacle or the tilt limit: there is no vehicle to point to
        client.hear(
            "mav0",
            position_enu_m=(0.0, 0.0, 1.0),
            law_status="saturated",
            avoids="",
            nearest_vehicle="mav1",
        )
        client.clock_ns += 200_000_000
        await see(app, pilot)
        assert "→" not in "\n".join(lines(app, PlanView))


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


async def test_a_person_is_drawn_where_the_motion_capture_sees_him() -> None:
    fleet = msgspec.structs.replace(crowd(4, side_m=8.0), people={"anna": Person(radius_m=1.0)})
    client = SteadyClient(fleet)
    app = ConsoleApp(client.fleet, client)
    async with app.run_test(size=(120, 40)) as pilot:
        await pilot.press("tab", "z")
        await see(app, pilot)
        assert "anna" not in "\n".join(lines(app, PlanView))

        seen = MocapPose(
            body="anna",
            boot_id=1,
            sequence=1,
            stamp_ns=client.now_ns(),
            is_tracked=True,
            position_enu_m=(-1.0, -2.0, 1.7),
            quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
        )
        client.state = fold(client.state, MocapPoses(poses=(seen,)), client.now_ns())
        await see(app, pilot)
        assert "anna" in "\n".join(lines(app, PlanView))
        [person] = client.state.people
        assert person.is_fresh(client.now_ns())
        assert not person.is_fresh(client.now_ns() + 2_000_000_000)

        lost = msgspec.structs.replace(seen, is_tracked=False, position_enu_m=(3.0, 3.0, 1.7))
        client.state = fold(client.state, MocapPoses(poses=(lost,)), client.now_ns())
        assert client.state.people == (person,), "who is not tracked stays where he was seen last"


async def test_a_picture_that_has_not_changed_is_not_drawn_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
