"""When another vehicle is a problem: silent, late, blind, beside its word, or too near soon."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from onboard.autopilot import Snapshot
from onboard.bus.schema import MocapPose, Order
from onboard.config.fleet import FleetConfig
from onboard.flight import effects
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep, FlightView
from onboard.neighbours.table import NeighbourTable
from onboard.safety.failsafe_table import Condition
from onboard.supervision.neighbour_monitor import NeighbourMonitor, SlowNeighbourFacts
from onboard.tuples import Xyz
from tests.groundstation.console.fake import telemetry
from tests.onboard.agent.rig import fleet
from tests.onboard.state_messages import state_message
from tests.sitl.square_fleets import square_fleet

S = 1_000_000_000
MS = 1_000_000
BEGIN_NS = 5 * S
STILL = (0.0, 0.0, 0.0)

FLEET = fleet(("mav0", "mav1", "mav2"))
LAYERED = replace(FLEET, fleet=replace(FLEET.fleet, vertical_separation_m=0.6))

MOVE = Order(
    order_id="1",
    author="ada",
    kind="move",
    stamp_ns=BEGIN_NS,
    deadline_ns=0,
    position_enu_m=(0.0, 2.0, 1.0),
)


class Watching:
    """mav0, which hovers 1 m above the origin, and what it hears of the others."""

    def __init__(self, config: FleetConfig = FLEET, step: FlightStep = FlightStep.HOLDING) -> None:
        vehicle = config.vehicles["mav0"]
        self.table = NeighbourTable(config, "mav0")
        self.flight = FlightContext(config, vehicle, step=step, order=MOVE)
        self.monitor = NeighbourMonitor(config, vehicle, self.table, self.flight)

    def hear(self, now_ns: int, vehicle: str = "mav1", **changes: Any) -> None:
        """Hear a state of another vehicle, sent now."""
        message = state_message(vehicle=vehicle, stamp_ns=now_ns, **changes)
        assert self.table.hear(message, now_ns)

    def update_slowly(self, now_ns: int = BEGIN_NS, **changes: Any) -> SlowNeighbourFacts:
        """Return the slow facts for the view of a hovering vehicle, with changes."""
        return self.monitor.update_slowly(view(now_ns, **changes))


def view(now_ns: int = BEGIN_NS, **changes: Any) -> FlightView:
    hovering = FlightView(
        now_ns=now_ns,
        position_enu_m=(0.0, 0.0, 1.0),
        velocity_enu_m_s=STILL,
        has_position=True,
        snapshot=Snapshot(),
    )
    return replace(hovering, **changes)


# -- silence


def test_a_silent_neighbour_is_unseen_when_a_second_tick_has_confirmed_it() -> None:
    watching = Watching()
    watching.hear(BEGIN_NS)
    assert watching.monitor.update(BEGIN_NS + 250 * MS) == ((), (), ())
    assert watching.monitor.update(BEGIN_NS + 260 * MS) == (("mav1",), (), ())
    assert watching.monitor.update(BEGIN_NS + 280 * MS) == (("mav1",), ("mav1",), ())


def test_two_silences_of_one_tick_are_no_silence_of_two() -> None:
    watching = Watching()
    watching.hear(BEGIN_NS)
    watching.monitor.update(BEGIN_NS + 260 * MS)
    watching.hear(BEGIN_NS + 280 * MS)
    watching.monitor.update(BEGIN_NS + 280 * MS)
    assert watching.monitor.update(BEGIN_NS + 540 * MS) == (("mav1",), (), ())


def test_a_neighbour_that_was_silent_is_heard_again_for_two_seconds() -> None:
    watching = Watching()
    watching.hear(BEGIN_NS)
    watching.monitor.update(BEGIN_NS + 260 * MS)
    watching.monitor.update(BEGIN_NS + 280 * MS)

    back_ns = BEGIN_NS + 300 * MS
    watching.hear(back_ns)
    assert watching.monitor.update(back_ns).heard_again == ("mav1",)
    for later_ms in (200, 400, 600, 800, 1000, 1200, 1400, 1600, 1800, 1999):
        watching.hear(back_ns + later_ms * MS)
        assert watching.monitor.update(back_ns + later_ms * MS).heard_again == ("mav1",)
    assert watching.monitor.update(back_ns + 2000 * MS).heard_again == ()


def test_of_two_silent_neighbours_the_one_that_speaks_is_heard_again() -> None:
    watching = Watching()
    watching.hear(BEGIN_NS)
    watching.hear(BEGIN_NS, vehicle="mav2", position_enu_m=(3.0, 0.0, 1.0))
    watching.monitor.update(BEGIN_NS + 260 * MS)
    watching.monitor.update(BEGIN_NS + 280 * MS)

    watching.hear(BEGIN_NS + 300 * MS, vehicle="mav2", position_enu_m=(3.0, 0.0, 1.0))
    silence = watching.monitor.update(BEGIN_NS + 300 * MS)
    assert silence.silent == ("mav1",)
    assert silence.heard_again == ("mav2",)


def test_a_silent_neighbour_that_the_mocap_sees_on_the_floor_is_not_heard_again() -> None:
    watching = Watching()
    watching.hear(BEGIN_NS)
    for later_ms in range(100, 281, 20):
        watching.table.bodies_to_watch(BEGIN_NS + later_ms * MS, 0.0)
        watching.monitor.update(BEGIN_NS + later_ms * MS)

    start_enu_m = FLEET.vehicles["mav1"].start_enu_m
    for later_ms in (300, 320, 340):
        stamp_ns = BEGIN_NS + later_ms * MS
        x, y, z = start_enu_m
        pose = MocapPose(
            body="mav1",
            boot_id=1,
            sequence=later_ms,
            stamp_ns=stamp_ns,
            position_enu_m=(x, y, z + 1e-4 * later_ms),
            quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
            is_tracked=True,
        )
        watching.table.hear_pose(pose, stamp_ns)
        silence = watching.monitor.update(stamp_ns)
    assert silence == ((), (), ())


# -- who keeps it off its goal


def kept_off(
    avoided: list[int], *, before: list[int] | None = None, config: FleetConfig = FLEET
) -> str:
    """Return the words after a leg in which the law avoided these neighbours, tick by tick."""
    watching = Watching(config, FlightStep.LEG)
    for index in before or []:
        watching.monitor.count_avoided(index)
    effects.fly_leg(watching.flight, view())
    for index in avoided:
        watching.monitor.count_avoided(index)
    return watching.monitor.kept_off_by((0.0, 2.0, 1.0), view())


NOBODY = -1


def test_who_was_avoided_in_more_than_three_ticks_of_ten_keeps_it_off() -> None:
    assert kept_off([]) == "still 2.00 m to go"
    assert kept_off([0] * 3 + [NOBODY] * 7) == "still 2.00 m to go"
    assert kept_off([0] * 4 + [NOBODY] * 9) == "still 2.00 m to go, kept off by mav1"
    assert kept_off([0] * 4 + [NOBODY] * 10) == "still 2.00 m to go"


def test_at_most_two_are_named_the_more_frequent_first() -> None:
    assert kept_off([1] * 5 + [0] * 4).endswith("kept off by mav2 and mav1")
    three = kept_off([2] * 36 + [1] * 33 + [0] * 31, config=square_fleet(4))
    assert three.endswith("kept off by mav3 and mav2")


def test_obstacles_and_a_neighbour_that_is_not_in_the_table_are_nobody() -> None:
    obstacle = -2
    beyond = len(FLEET.vehicles) - 1
    assert kept_off([obstacle] * 10) == "still 2.00 m to go"
    assert kept_off([beyond] * 10) == "still 2.00 m to go"


def test_who_was_avoided_on_an_earlier_leg_does_not_count() -> None:
    assert kept_off([NOBODY] * 10, before=[0] * 100) == "still 2.00 m to go"
    assert kept_off([0] * 4 + [NOBODY] * 9, before=[NOBODY] * 100).endswith("kept off by mav1")


# -- the nearest one


def test_the_nearest_neighbour_is_the_one_that_is_nearest_now() -> None:
    watching = Watching()
    watching.hear(BEGIN_NS, position_enu_m=(1.0, 0.0, 1.0), velocity_enu_m_s=(-4.0, 0.0, 0.0))
    watching.hear(BEGIN_NS, vehicle="mav2", position_enu_m=(0.0, 0.5, 1.0))
    here = (0.0, 0.0, 1.0)
    assert watching.monitor.nearest_to(here, 2.0, BEGIN_NS) == "mav2"
    assert watching.monitor.nearest_to(here, 2.0, BEGIN_NS + 200 * MS) == "mav1"
    assert watching.monitor.nearest_to(here, 0.4, BEGIN_NS) == ""


def test_a_silent_neighbour_is_not_the_nearest() -> None:
    watching = Watching()
    watching.hear(BEGIN_NS, position_enu_m=(0.0, 0.2, 1.0))
    here = (0.0, 0.0, 1.0)
    assert watching.monitor.nearest_to(here, 2.0, BEGIN_NS + 240 * MS) == "mav1"
    assert watching.monitor.nearest_to(here, 2.0, BEGIN_NS + 260 * MS) == ""


# -- those that have no position, are late, blind, or fly by another file


def test_nobody_has_a_problem_before_anybody_is_heard() -> None:
    assert Watching().update_slowly() == ((),) * len(SlowNeighbourFacts._fields)


def test_a_neighbour_that_says_that_it_has_no_position_or_is_late_is_named() -> None:
    watching = Watching()
    watching.hear(BEGIN_NS)
    watching.hear(BEGIN_NS, vehicle="mav2", position_enu_m=(3.0, 0.0, 1.0))
    later_ns = BEGIN_NS + 200 * MS
    watching.hear(later_ns, is_valid=False)
    facts = watching.update_slowly(later_ns)
    assert facts.without_position == ("mav1",)
    assert facts.late == ("mav1", "mav2")


@pytest.mark.parametrize(
    ("state_age_s", "is_airborne", "is_heard", "is_own_blind", "is_named"),
    [
        (0.26, True, True, False, True),
        (0.25, True, True, False, False),
        (0.26, False, True, False, False),
        (0.26, True, False, False, False),
        (0.26, True, True, True, False),  # all of them have lost their poses
    ],
)
def test_a_neighbour_in_the_air_without_poses_is_blind(
    *, state_age_s: float, is_airborne: bool, is_heard: bool, is_own_blind: bool, is_named: bool
) -> None:
    watching = Watching()
    heard_ns = BEGIN_NS if is_heard else BEGIN_NS - S
    watching.hear(heard_ns)
    told = telemetry("mav1", state_age_s=state_age_s, is_airborne=is_airborne)
    watching.table.hear(told, BEGIN_NS)
    facts = watching.update_slowly(is_dead_reckoned=is_own_blind)
    assert facts.blind == (("mav1",) if is_named else ())


def test_a_neighbour_for_which_the_wind_is_too_strong_is_named_while_it_is_heard() -> None:
    watching = Watching()
    watching.hear(BEGIN_NS)
    watching.hear(BEGIN_NS, vehicle="mav2", position_enu_m=(3.0, 0.0, 1.0))
    conditions = (Condition.WIND_NEAR.value, Condition.WIND_ABOVE.value)
    watching.table.hear(telemetry("mav1", conditions=conditions), BEGIN_NS)
    watching.table.hear(telemetry("mav2", conditions=conditions[:1]), BEGIN_NS)
    assert watching.update_slowly().too_windy_for == ("mav1",)

    watching.hear(BEGIN_NS + 2 * S, vehicle="mav2", position_enu_m=(3.0, 0.0, 1.0))
    assert watching.update_slowly(now_ns=BEGIN_NS + 2 * S).too_windy_for == ()

    pushed_about = (Condition.PUSHED_ABOUT.value,)
    later = telemetry("mav2", conditions=pushed_about, stamp_ns=BEGIN_NS + 2 * S)
    watching.table.hear(later, BEGIN_NS + 2 * S)
    assert watching.update_slowly(now_ns=BEGIN_NS + 2 * S).too_windy_for == ("mav2",)


def test_a_neighbour_with_another_file_is_named_and_not_relied_on() -> None:
    watching = Watching()
    watching.hear(BEGIN_NS)
    watching.hear(BEGIN_NS, vehicle="mav2", position_enu_m=(3.0, 0.0, 1.0))
    watching.table.hear(telemetry("mav1", config_hash="another"), BEGIN_NS)
    watching.table.hear(telemetry("mav2", config_hash=FLEET.config_hash), BEGIN_NS)
    facts = watching.update_slowly()
    assert facts.other_files == ("mav1",)
    assert facts.uncooperative == ()
    assert watching.table.judged.not_cooperating == {watching.table.indices["mav1"]}


# -- those that do not fly as they say


@pytest.mark.parametrize(
    ("most_m_s", "speed_m_s", "is_named"),
    [(1.0, 14.0, False), (1.0, 16.0, True), (10.0, 29.0, False), (10.0, 31.0, True)],
)
def test_a_neighbour_that_says_twice_that_it_flies_too_fast_is_implausible(
    *, most_m_s: float, speed_m_s: float, is_named: bool
) -> None:
    vehicles = {
        name: replace(vehicle, max_speed_m_s=most_m_s) for name, vehicle in FLEET.vehicles.items()
    }
    watching = Watching(replace(FLEET, vehicles=vehicles))
    index = watching.table.indices["mav1"]
    judged = watching.table.judged

    for number in range(2):
        now_ns = BEGIN_NS + number * 100 * MS
        x = 20.0 + 0.1 * number * speed_m_s
        place = (x, 0.0, 1.0)
        there = (x + 0.15 * speed_m_s, 0.0, 1.0)
        fast = (speed_m_s, 0.0, 0.0)
        watching.hear(
            now_ns,
            position_enu_m=place,
            velocity_enu_m_s=fast,
            predicted_position_enu_m=there,
            predicted_velocity_enu_m_s=fast,
        )
        facts = watching.update_slowly(now_ns)
        assert (index in judged.watched) is is_named
        assert (index in judged.contradicted) is (is_named and number == 1)

    said = (f"mav1 says that it flies {speed_m_s:.0f} m/s",)
    assert facts.implausible == (said if is_named else ())
    assert (index in judged.not_cooperating) is is_named


def test_a_contradicted_neighbour_that_is_not_followed_any_more_is_soon_contradicted_no_more() -> (
    None
):
    watching = Watching(square_fleet(8))
    table = watching.table
    index = table.indices["mav1"]

    def pass_time(begin_ns: int, count: int, others_m: float, **state: Any) -> int:
        """Hear all neighbours ten times a second; return the last time."""
        for number in range(count):
            now_ns = begin_ns + 100 * MS * number
            watching.hear(now_ns, **state)
            for name in table.names:
                if name != "mav1":
                    watching.hear(now_ns, name, position_enu_m=(others_m, 0.0, 1.0))
            table.select_followed((0.0, 0.0, 1.0), now_ns)
            table.reposition_contradicted((0.0, 0.0, 1.0), now_ns)
            watching.update_slowly(now_ns)
        return now_ns

    fast_m_s = (90.0, 0.0, 0.0)
    now_ns = pass_time(BEGIN_NS, 4, 20.0, position_enu_m=(3.0, 0.0, 1.0), velocity_enu_m_s=fast_m_s)
    assert index in table.judged.contradicted

    # it stands far away and says so, and others are nearer
    standing = {"position_enu_m": (30.0, 0.0, 0.0), "predicted_position_enu_m": (30.0, 0.0, 0.0)}
    now_ns = pass_time(now_ns + 100 * MS, 40, 2.0, is_airborne=False, **standing)
    assert "mav1" not in table.followed
    assert index not in table.judged.contradicted
    assert "mav1" not in table.silent(now_ns + 60 * S)


def predicting(watching: Watching, count: int, *, is_cooperative: bool = True) -> None:
    """Hear a neighbour that stands, and says each time that it will soon fly 1 m/s."""
    for number in range(count):
        now_ns = BEGIN_NS + number * 100 * MS
        watching.hear(
            now_ns, is_cooperative=is_cooperative, predicted_velocity_enu_m_s=(1.0, 0.0, 0.0)
        )
        watching.update_slowly(now_ns)


def test_a_neighbour_that_does_not_fly_as_it_predicts_is_not_relied_on() -> None:
    watching = Watching()
    predicting(watching, 20)
    end_ns = BEGIN_NS + 19 * 100 * MS
    assert watching.update_slowly(end_ns).uncooperative == ("mav1",)
    assert watching.table.judged.not_cooperating == {watching.table.indices["mav1"]}

    # once it is silent, that is said instead
    assert watching.update_slowly(end_ns + 300 * MS).uncooperative == ()
    assert not watching.table.judged.not_cooperating


def test_who_does_not_cooperate_predicts_nothing() -> None:
    watching = Watching()
    predicting(watching, 20, is_cooperative=False)
    assert watching.update_slowly(BEGIN_NS + 19 * 100 * MS).uncooperative == ()


# -- those that will be too near


def endangered(
    position_enu_m: Xyz,
    velocity_enu_m_s: Xyz,
    *,
    config: FleetConfig = FLEET,
    own_velocity_enu_m_s: Xyz = STILL,
    is_cooperative: bool = True,
    age_ms: int = 0,
    has_position: bool = True,
    step: FlightStep = FlightStep.HOLDING,
) -> bool:
    """Return whether a neighbour endangers a vehicle in the middle, 1 m above the ground."""
    watching = Watching(config, step)
    watching.hear(
        BEGIN_NS - age_ms * MS,
        position_enu_m=position_enu_m,
        velocity_enu_m_s=velocity_enu_m_s,
        is_cooperative=is_cooperative,
    )
    facts = watching.update_slowly(velocity_enu_m_s=own_velocity_enu_m_s, has_position=has_position)
    return facts.endangered == ("mav1",)


def along(axis: int, size: float, height_m: float = 0.0) -> Xyz:
    """Return a vector to the east (axis 0) or to the north."""
    return (size, 0.0, height_m) if axis == 0 else (0.0, size, height_m)


# 0.8 m are kept, and 3 cm less are tolerated. At 1 m/s a vehicle flies 0.15 m before it brakes, and
# then 0.07 m while both brake with 3.66 m/s^2, or 0.14 m while one of them does.
@pytest.mark.parametrize(
    ("apart_m", "is_cooperative", "age_ms", "is_endangered"),
    [
        (0.980, True, 0, True),
        (0.995, True, 0, False),
        (1.050, False, 0, True),
        (1.065, False, 0, False),
        (1.080, True, 100, True),
        (1.095, True, 100, False),
        (0.810, True, 0, True),
        (0.790, True, 0, False),  # it is too near already
        (0.980, True, 260, False),  # it is silent
    ],
)
@pytest.mark.parametrize("is_own", [True, False])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_neighbour_endangers_if_braking_does_not_keep_the_distance(
    *,
    apart_m: float,
    is_cooperative: bool,
    age_ms: int,
    is_endangered: bool,
    is_own: bool,
    axis: int,
    sign: float,
) -> None:
    closing_m_s = along(axis, sign if is_own else -sign)
    found = endangered(
        along(axis, sign * apart_m, height_m=1.0),
        STILL if is_own else closing_m_s,
        own_velocity_enu_m_s=closing_m_s if is_own else STILL,
        is_cooperative=is_cooperative,
        age_ms=age_ms,
    )
    assert found is is_endangered


def test_only_who_flies_the_law_at_a_known_position_is_endangered() -> None:
    place = (0.95, 0.0, 1.0)
    towards = (-1.0, 0.0, 0.0)
    assert endangered(place, towards)
    assert not endangered(place, towards, has_position=False)
    assert not endangered(place, towards, step=FlightStep.PX4_LANDING)


@pytest.mark.parametrize(("apart_m", "is_endangered"), [(4.9, True), (5.1, False)])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_neighbour_endangers_from_within_five_metres(
    apart_m: float, is_endangered: bool, axis: int
) -> None:
    place = along(axis, -apart_m, height_m=1.0)
    assert endangered(place, along(axis, 10.0)) is is_endangered


# In a fleet with 0.6 m between heights a motion towards the other is expected to last for 0.5 s.
@pytest.mark.parametrize(
    ("above_m", "own_climb_m_s", "their_climb_m_s", "is_endangered"),
    [
        (0.63, 0.0, 0.0, False),
        (-0.63, 0.0, 0.0, False),
        (0.59, 0.0, 0.0, True),
        (-0.59, 0.0, 0.0, True),
        (0.65, 0.08, 0.0, False),
        (0.65, 0.12, 0.0, True),
        (0.65, 0.0, -0.12, True),
        (-0.65, -0.12, 0.0, True),
        (-0.65, 0.0, 0.12, True),
        (0.65, 0.0, 0.5, False),  # it goes away
        (0.55, 0.0, 5.0, True),  # it is too near as long as it is
    ],
)
def test_a_neighbour_at_another_height_endangers_if_the_heights_meet(
    above_m: float, own_climb_m_s: float, their_climb_m_s: float, is_endangered: bool
) -> None:
    found = endangered(
        (0.95, 0.0, 1.0 + above_m),
        (-1.0, 0.0, their_climb_m_s),
        config=LAYERED,
        own_velocity_enu_m_s=(0.0, 0.0, own_climb_m_s),
    )
    assert found is is_endangered


@pytest.mark.parametrize(("above_m", "is_endangered"), [(3.0, True), (-0.65, False)])
def test_below_one_that_does_not_cooperate_no_height_is_enough(
    above_m: float, is_endangered: bool
) -> None:
    place = (0.95, 0.0, 1.0 + above_m)
    towards = (-1.0, 0.0, 0.0)
    assert endangered(place, towards, config=LAYERED, is_cooperative=False) is is_endangered
    assert not endangered(place, towards, config=LAYERED)


def test_above_one_that_does_not_cooperate_a_small_separation_is_enough() -> None:
    tiny = replace(FLEET, fleet=replace(FLEET.fleet, vertical_separation_m=0.05))
    place = (0.95, 0.0, 0.92)
    assert not endangered(place, (-1.0, 0.0, 0.0), config=tiny, is_cooperative=False)


def test_without_a_vertical_separation_no_height_is_enough() -> None:
    assert endangered((0.95, 0.0, 9.0), (-1.0, 0.0, 0.0))
