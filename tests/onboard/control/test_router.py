"""A vehicle is led around what stands in its way, and gives way in a passage for one."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from onboard.avoidance.params import Capsule, params_of
from onboard.config.law import LawConfig
from onboard.control import parked, router, yielding
from onboard.control.router import PERIOD_S
from onboard.rollout.fleet_routes import FleetRoutes
from onboard.types import Goal, Neighbour, State
from onboard.vectors import ZERO_3, Vec2, Vec3
from sitl.monte_carlo import campaign_settings, scenarios
from sitl.monte_carlo.batch_flight import Flown, fly
from sitl.monte_carlo.open_benchmark import scene_file, scene_plans

WALL = Capsule(Vec2(0.0, -1.0), Vec2(0.0, 1.0), 0.1)
TICK_S = 0.02


class Way:
    """One vehicle's way among static things, tick by tick."""

    def __init__(self, still: Sequence[Capsule]) -> None:
        self._around = router.surroundings(still, params_of(LawConfig()))
        self._memory = router.RouteMemory()

    def toward(
        self, state: State, goal: Goal, neighbours: Sequence[Neighbour] = (), dt_s: float = TICK_S
    ) -> Goal:
        self._memory, leg = router.step(self._memory, state, goal, neighbours, self._around, dt_s)
        return leg


def at(x: float, y: float, speed_m_s: float = 0.0) -> State:
    return State(
        position_enu_m=Vec3(x, y, 1.0),
        velocity_enu_m_s=Vec3(speed_m_s, 0.0, 0.0),
        acceleration_enu_m_s2=ZERO_3,
        yaw_rad=0.0,
        age_s=0.0,
        position_std_m=0.0,
        velocity_std_m_s=0.0,
    )


def to(x: float, y: float, sequence: int = 7, duration_s: float = 0.0) -> Goal:
    return Goal(Vec3(x, y, 1.0), duration_s, sequence)


def test_a_goal_in_sight_passes_unchanged() -> None:
    way = Way([WALL])
    goal = to(3.0, 4.0, duration_s=9.0)
    assert way.toward(at(-3.0, 4.0), goal) is goal


def test_without_static_things_every_goal_passes_unchanged() -> None:
    goal = to(3.0, 0.0)
    assert Way([]).toward(at(-3.0, 0.0), goal) is goal


def test_behind_a_wall_the_first_leg_leads_past_its_end_and_the_last_to_the_goal() -> None:
    way = Way([WALL])
    goal = to(3.0, 0.1)

    leg = way.toward(at(-3.0, 0.1), goal)
    assert leg.position_enu_m.y > 1.0
    assert leg.sequence < 0  # no order has such a number
    assert leg.duration_s == 0.0

    again = way.toward(at(-2.9, 0.15), goal, (), PERIOD_S)
    assert again == leg  # the same corner is no new leg

    last = way.toward(at(0.5, 1.6), goal, (), PERIOD_S)
    assert last.position_enu_m == goal.position_enu_m
    assert last.sequence == goal.sequence
    assert last.duration_s == 0.0


def test_an_ordered_duration_is_that_of_the_whole_way() -> None:
    way = Way([WALL])
    goal = to(3.0, 0.1, duration_s=60.0)
    first = way.toward(at(-3.0, 0.1), goal)
    last = way.toward(at(0.5, 1.6), goal, (), PERIOD_S)
    assert 20.0 < first.duration_s < 40.0
    assert last.duration_s == pytest.approx(60.0 * 2.915 / 6.9, rel=0.05)


def test_whoever_gives_way_does_not_take_the_ordered_time_for_it() -> None:
    goal = to(4.0, 0.0)._replace(duration_s=60.0)
    back = leg_after(5.0, at(-0.45, 0.0), goal, facing(0.45, -1.0))
    assert back.duration_s == 0.0


def test_a_new_order_is_followed_at_once() -> None:
    way = Way([WALL])
    way.toward(at(-3.0, 0.1), to(3.0, 0.1))
    back = to(-5.0, 0.0, sequence=8, duration_s=5.0)
    assert way.toward(at(-3.0, 0.1), back) == back


def test_a_noisy_estimate_does_not_turn_a_vehicle_to_and_fro_between_two_ways() -> None:
    way = Way([WALL])
    errors = random.Random(1)
    legs = set()
    for _ in range(50):
        state = at(-3.0, errors.gauss(0.0, 0.05))
        legs.add(way.toward(state, to(3.0, 0.0), (), PERIOD_S).position_enu_m)
    assert len(legs) == 1


@pytest.mark.parametrize("position", [(math.nan, 0.0), (math.inf, 0.0)])
def test_a_position_that_is_not_finite_changes_no_goal(position: tuple[float, float]) -> None:
    way = Way([WALL])
    goal = to(3.0, 0.0)
    assert way.toward(at(*position), goal) is goal


def test_a_position_that_is_not_finite_on_the_way_around_begins_no_new_leg() -> None:
    way = Way([WALL])
    goal = to(3.0, 0.0)
    leg = way.toward(at(-3.0, 0.1), goal)
    assert way.toward(at(math.nan, 0.1), goal, (), PERIOD_S) == leg


def test_a_path_is_flown_as_it_was_loaded() -> None:
    way = Way([WALL])
    goal = to(3.0, 0.0)._replace(is_on_path=True)
    assert way.toward(at(-3.0, 0.0), goal) is goal


def test_a_fence_above_or_below_the_flight_is_in_nobodys_way() -> None:
    middle = Vec2(0.0, 0.0)
    tree = Capsule(middle, middle, 0.5, area=1, keep_m=0.4, is_turned_about=True, high_m=0.8)
    goal = to(3.0, 0.0)
    assert Way([tree]).toward(at(-3.0, 0.0), goal) is goal
    low = goal._replace(position_enu_m=Vec3(3.0, 0.0, 0.5))  # it comes down into its heights
    assert Way([tree]).toward(at(-3.0, 0.0), low) != low


# -- two that meet in a passage for one --------------------------------------------------------

LANE = [Capsule(Vec2(-2.0, side * 0.7), Vec2(2.0, side * 0.7), 0.05) for side in (-1.0, 1.0)] + [
    Capsule(Vec2(x, side * 0.7), Vec2(x, side * 4.2), 0.05)
    for x in (-2.0, 2.0)
    for side in (-1.0, 1.0)
]


def facing(x: float, intent_m_s: float, *, is_cooperative: bool = True) -> Neighbour:
    place = Vec3(x, 0.0, 1.0)
    return Neighbour(
        position_enu_m=place,
        velocity_enu_m_s=ZERO_3,
        acceleration_enu_m_s2=ZERO_3,
        predicted_position_enu_m=place,
        predicted_velocity_enu_m_s=ZERO_3,
        commanded_acceleration_enu_m_s2=ZERO_3,
        intent_enu_m_s=Vec3(intent_m_s, 0.0, 0.0),
        age_s=0.0,
        lead_time_s=0.15,
        position_std_m=0.0,
        velocity_std_m_s=0.0,
        crowd_count=0.0,
        is_cooperative=is_cooperative,
        is_paper_obstacle=False,
        table_index=0,
        radius_m=0.0,
    )


def leg_after(
    seconds: float, here: State, goal: Goal, neighbour: Neighbour, way: Way | None = None
) -> Goal:
    way = way or Way(LANE)
    for _ in range(round(seconds / PERIOD_S)):
        leg = way.toward(here, goal, [neighbour], PERIOD_S)
    return leg


def test_of_two_that_meet_only_the_one_further_west_goes_back() -> None:
    west = leg_after(5.0, at(-0.45, 0.0), to(4.0, 0.0), facing(0.45, -1.0))
    east = leg_after(5.0, at(0.45, 0.0), to(-4.0, 0.0), facing(-0.45, 1.0))
    assert west.position_enu_m.x < -2.0
    assert east == to(-4.0, 0.0)


def test_nobody_goes_back_before_they_have_stood_for_a_while() -> None:
    assert leg_after(3.0, at(-0.45, 0.0), to(4.0, 0.0), facing(0.45, -1.0)) == to(4.0, 0.0)


def test_if_the_other_one_does_not_go_this_one_does() -> None:
    east = leg_after(13.0, at(0.45, 0.0), to(-4.0, 0.0), facing(-0.45, 1.0))
    assert east.position_enu_m.x > 2.0


def test_whoever_waits_goes_on_when_the_way_is_free_again() -> None:
    way = Way(LANE)
    goal = to(4.0, 0.0)
    leg_after(5.0, at(-0.45, 0.0), goal, facing(0.45, -1.0), way)
    waiting = way.toward(at(-2.5, 0.0), goal, [facing(-1.5, -1.0)], PERIOD_S)
    assert waiting.position_enu_m.x < -2.0

    on = way.toward(at(-2.5, 0.0), goal, [facing(-6.0, -1.0)], PERIOD_S)
    assert on.position_enu_m == goal.position_enu_m


def test_a_vehicle_that_waits_for_nobody_goes_on_in_the_end() -> None:
    way = Way(LANE)
    goal = to(4.0, 0.0)
    leg_after(5.0, at(-0.45, 0.0), goal, facing(0.45, -1.0), way)
    for _ in range(round(16.0 / PERIOD_S)):
        leg = way.toward(at(-2.5, 0.0), goal, [facing(-1.5, -1.0)], PERIOD_S)
    assert leg.position_enu_m == goal.position_enu_m


@pytest.mark.parametrize(
    ("neighbour", "why"),
    [
        (facing(0.45, 1.0), "it flies the same way"),
        (facing(0.45, 0.0), "it stands at its goal"),
        (facing(0.45, -1.0, is_cooperative=False), "it gives way to nobody"),
        (facing(2.5, -1.0), "it is far away"),
        (facing(-1.3, 1.0), "it is behind"),
    ],
)
def test_nobody_goes_back_for_a_vehicle(neighbour: Neighbour, why: str) -> None:
    assert leg_after(7.0, at(-0.45, 0.0), to(4.0, 0.0), neighbour) == to(4.0, 0.0), why


def test_a_vehicle_in_motion_has_met_nobody() -> None:
    leg = leg_after(8.0, at(-0.45, 0.0, 0.6), to(4.0, 0.0), facing(0.45, -1.0))
    assert leg == to(4.0, 0.0)


def test_a_vehicle_that_is_pushed_to_and_fro_has_met_the_other_one() -> None:
    leg = leg_after(8.0, at(-0.45, 0.0, 0.4), to(4.0, 0.0), facing(0.45, -1.0))
    assert leg != to(4.0, 0.0)


# -- flown -------------------------------------------------------------------------------------


def flown_scene(path: str | Path, seeds: int) -> list[Flown]:
    scene = scene_file.load(path)
    plans = [scene_plans.plan(scene, seed) for seed in range(1000, 1000 + seeds)]
    return fly(plans, scene_plans.setup(scene))


def lane_scene(
    path: Path, starts: list[list[float]], turn_deg: float, delay_s: float = 0.04
) -> Path:
    angle = math.radians(turn_deg)

    def turned(x: float, y: float) -> list[float]:
        return [
            x * math.cos(angle) - y * math.sin(angle),
            x * math.sin(angle) + y * math.cos(angle),
        ]

    obstacles = []
    for capsule in LANE:
        obstacles.append(
            {
                "begin_enu_m": turned(*capsule.begin_enu_m),
                "end_enu_m": turned(*capsule.end_enu_m),
                "radius_m": capsule.radius_m,
            }
        )
    scene = {
        "schema": 1,
        "name": "lane",
        "about": "They meet in a passage for one.",
        "placing": {
            "type": "listed",
            "start_enu_m": [turned(*start) for start in starts],
            "goal_enu_m": [turned(-x, y) for x, y in starts],
        },
        "obstacles": obstacles,
        "set": {"delay_s": delay_s},
        "within_s": 120.0,
    }
    path.write_text(json.dumps(scene))
    return path


_TWO = [[-4.0, 0.0], [4.0, 0.0]]
_FOUR = [[-4.0, 0.0], [-5.2, 0.0], [4.0, 0.0], [5.2, 0.0]]


@pytest.mark.parametrize(
    ("starts", "turn_deg"),
    [
        (_TWO, 70.0),
        pytest.param(_TWO, 0.0, marks=pytest.mark.long),
        pytest.param(_FOUR, 0.0, marks=pytest.mark.long),
        pytest.param(_FOUR, 70.0, marks=pytest.mark.long),
    ],
)
def test_all_get_through_a_passage_for_one(
    tmp_path: Path, starts: list[list[float]], turn_deg: float
) -> None:
    for flown in flown_scene(lane_scene(tmp_path / "lane.json", starts, turn_deg), seeds=2):
        assert flown.outcome.is_success
        assert flown.outcome.min_separation_m > 0.8


@pytest.mark.long
def test_all_get_through_a_passage_for_one_with_late_messages(tmp_path: Path) -> None:
    """With messages of 200 ms, two vehicles that stand face to face swing with up to 0.4 m/s."""
    starts = [[-4.0, 0.0], [-5.2, 0.0], [4.0, 0.0], [5.2, 0.0]]
    scene = lane_scene(tmp_path / "lane.json", starts, turn_deg=0.0, delay_s=0.2)
    for flown in flown_scene(scene, seeds=2):
        assert flown.outcome.is_success
        assert flown.outcome.min_separation_m > 0.8


@pytest.mark.long
def test_the_maze_needs_the_routes(monkeypatch: pytest.MonkeyPatch) -> None:
    assert all(flown.outcome.is_success for flown in flown_scene("maze.json", seeds=2))

    monkeypatch.setattr(FleetRoutes, "goals", lambda _, __, goals, *rest: goals)
    assert not any(flown.outcome.is_success for flown in flown_scene("maze.json", seeds=2))


# -- parked vehicles in the way ------------------------------------------------------------------

# a pocket that is open to the west: neighbours are nearer together than two distances to keep
POCKET = [(-1.2, 1.2), (0.0, 1.1), (0.0, 0.0), (0.0, -1.1), (-1.2, -1.2)]


def parked_at(x: float, y: float, intent_m_s: float = 0.0) -> Neighbour:
    place = Vec3(x, y, 1.0)
    return facing(x, intent_m_s)._replace(position_enu_m=place, predicted_position_enu_m=place)


def stand(way: Way, here: State, seconds: float, neighbours: Sequence[Neighbour]) -> Goal:
    for _ in range(round(seconds / PERIOD_S)):
        leg = way.toward(here, to(3.0, 0.0), neighbours, PERIOD_S)
    return leg


def test_a_vehicle_before_parked_ones_flies_around_them_after_a_while() -> None:
    pocket = [parked_at(x, y) for x, y in POCKET]
    way = Way([])
    assert stand(way, at(-0.95, 0.0), 7.0, pocket) == to(3.0, 0.0)
    leg = stand(way, at(-0.95, 0.0), 2.0, pocket)
    assert leg.position_enu_m.x < -1.2  # out of the pocket first

    last = way.toward(at(1.5, 1.5), to(3.0, 0.0), pocket, PERIOD_S)
    assert last.position_enu_m == Vec3(3.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("here", "neighbours", "why"),
    [
        (at(-0.95, 0.0, 0.5), POCKET, "it moves"),
        (at(2.8, 0.0), POCKET, "it is at its goal"),
        (at(-3.0, 0.0), POCKET, "they are far away: something else holds it back"),
        (at(-0.95, 0.0), [], "nobody is there"),
    ],
)
def test_nothing_changes_for_a_vehicle_without_parked_ones_before_it(
    here: State, neighbours: list[tuple[float, float]], why: str
) -> None:
    standing = [parked_at(x, y) for x, y in neighbours]
    assert stand(Way([]), here, 20.0, standing) == to(3.0, 0.0), why


def test_whoever_intends_to_go_on_is_not_parked() -> None:
    going = [parked_at(x, y, 1.0) for x, y in POCKET]
    assert stand(Way([]), at(-0.95, 0.0), 20.0, going) == to(3.0, 0.0)


@pytest.mark.long
def test_a_vehicle_that_parked_ones_held_for_ever_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    # the parked ones receive no messages, so they do not step aside
    starts = [(-3.0, 0.0), *POCKET]
    goals = [(3.0, 0.0), *POCKET]
    plan = scenarios.FlightPlan(
        scenario="pocket",
        seed=1,
        start_enu_m=np.array([(x, y, 1.0) for x, y in starts]),
        goal_enu_m=np.array([(x, y, 1.0) for x, y in goals]),
        blind=tuple(range(1, len(starts))),
    )
    setup = campaign_settings.setup_for(types="sih,ardrone")
    (flown,) = fly([plan], setup)
    assert flown.outcome.is_success
    assert flown.outcome.min_separation_m > 0.8

    monkeypatch.setattr(FleetRoutes, "goals", lambda _, __, goals, *rest: goals)
    (held,) = fly([plan], setup)
    assert not held.outcome.is_success


def test_beside_many_obstacles_fewer_parked_vehicles_count() -> None:
    assert parked.most_pillars(0, 0) == 8
    assert 0 < parked.most_pillars(40, 4) < 8
    assert parked.most_pillars(96, 12) == 0


def test_a_refuge_does_not_lie_past_an_opponent_abreast_in_a_strip_just_wide_enough() -> None:
    # Two walls leave a strip for centres that is as wide as the distance between two vehicles.
    west = Capsule(Vec2(-1.9, -1.0), Vec2(-1.9, 1.0), 0.0)
    east = Capsule(Vec2(-0.1, 0.7), Vec2(-0.1, 4.5), 0.0)
    around = router.surroundings([west, east], params_of(LawConfig()))
    opponent = yielding.Opponent(
        position_m=Vec2(-0.55, 0.84),
        direction=Vec2(-0.885, 0.465),
        distance_m=0.9,
        table_index=0,
    )

    refuge = yielding.nearest_refuge(
        here=Vec2(-1.46, 0.89),
        opponent=opponent,
        route_map=router.map_of(around.still, around),
    )

    assert refuge is not None
    assert refuge.x < west.begin_enu_m.x  # around the northern end of the western wall
