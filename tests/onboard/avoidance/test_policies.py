"""Policies of the law by name, what each does, and that one choice of them is the paper's law
exactly.
"""

import math

import msgspec
import numpy as np
import pytest

from onboard.avoidance import interface, oist
from onboard.avoidance.constraints import distance_row, turn_sign
from onboard.avoidance.oist_paper import PlanarState, saturate_thrust
from onboard.avoidance.pairs import LARGEST_MARGIN_M, NeighbourPair, design_distance, margin_2
from onboard.avoidance.params import (
    DIRECTION_CROWD,
    DIRECTION_FIXED,
    DIRECTION_INTENT,
    DIRECTION_PAIR,
    ROTATION_NEVER,
    LawParams,
    law_params,
    obstacles,
)
from onboard.avoidance.prediction import LONGEST_LEAD_S, Motion
from onboard.config.fleet import load_fleet
from onboard.config.law import LawConfig
from onboard.control import pipeline
from onboard.types import LawStatus
from onboard.vectors import ZERO_3, ZERO_XY, Vec2, Vec3
from tests.onboard.avoidance.law_cases import (
    horizontal,
    law_of,
    neighbour_of,
    run,
    state_of,
    thrust_of,
    vec,
)

MOCAP = (0.002, 0.01)  # standard deviations of position and velocity [m, m/s]

PAPER_WAY = {
    "responsibility": "full", "prediction": "none", "margin": "fixed", "rotation": "always",
    "direction": "fixed",
    "design_margin_m": 0.0, "lag_margin_m_s": 0.0, "kappa_1_1_s": 2.0, "kappa_2_1_s": 2.0,
    "kappa_3_1_s": 1.5,
    "kappa_4_1_s": 1.5, "v_perp_m_s": 0.1, "avoid_speed_frac": 100.0, "range_m": 100.0,
}  # fmt: skip
UNLIMITED = {"max_tilt_rad": math.radians(89.99), "max_thrust_m_s2": 1e4}
EAST = Vec3(1.0, 0.0, 0.0)


def test_one_neighbour_the_papers_policies_and_no_limits_give_equation_22():
    params = law_of(UNLIMITED, **PAPER_WAY)
    rng = np.random.default_rng(5)
    changed = 0
    for case in range(200):
        p, v, a = rng.normal(size=(3, 3)) * np.array([[0.5], [0.5], [2.0]])
        q, w, b = rng.normal(size=(3, 3)) * np.array([[1.0], [0.5], [1.0]])
        a[2] = 0.0
        out = run(p, v, a, [neighbour_of(q, w, b)], params)
        own = PlanarState(Vec2(*map(float, p[:2])), Vec2(*map(float, v[:2])), ZERO_XY)
        obstacle = PlanarState(*(Vec2(*map(float, x[:2])) for x in (q, w, b)))
        reference = saturate_thrust(own, Vec2(*map(float, a[:2])), obstacle, params.paper)
        error = np.abs(horizontal(out.thrust.thrust_enu_m_s2) - reference.thrust_m_s2)
        assert (error <= 1e-5 * (1.0 + np.abs(reference.thrust_m_s2))).all(), case
        changed += reference.is_changed
    assert changed > 50


def test_every_policy_of_the_configuration_flies_a_tick():
    neighbours = [neighbour_of([1.2, 0.1, 0.0], [-0.5, 0.0, 0.0])]
    kind = msgspec.inspect.type_info(LawConfig)
    assert isinstance(kind, msgspec.inspect.StructType | msgspec.inspect.DataclassType)
    policies = {
        field.name: field.type.values
        for field in kind.fields
        if isinstance(field.type, msgspec.inspect.LiteralType)
    }
    assert {"responsibility", "prediction", "margin", "rotation", "direction", "jam"} <= set(
        policies
    )
    for name, values in policies.items():
        for value in values:
            out = run(
                np.zeros(3), [0.8, 0.0, 0.0], np.zeros(3), neighbours, law_of(**{name: value})
            )
            assert np.isfinite(out.thrust.thrust_enu_m_s2).all(), (name, value)


def test_policies_are_taken_from_the_fleet_file():
    fleet = load_fleet("configs/fleets/sih.toml")
    fleet = msgspec.structs.replace(
        fleet, law=msgspec.structs.replace(fleet.law, prediction="none", rotation="never")
    )
    params = pipeline.pipeline_params(fleet, next(iter(fleet.vehicles)))
    assert params.law.policies.rotation == ROTATION_NEVER
    assert params.law.lead_time_s == 0.0
    assert params.trajectory.lead_s == 0.0


def test_law_may_be_chosen_in_place_of_the_fleet_files_and_only_one_that_there_is():
    fleet = load_fleet("configs/fleets/sih.toml")
    vehicle = next(iter(fleet.vehicles))
    assert {law_params(fleet, vehicle, name).law for name in ("off", "paper", "covey")} == {0, 1, 2}
    with pytest.raises(ValueError, match="there are only off, paper, covey"):
        law_params(fleet, vehicle, "best")


def numbers_of(value):
    return [
        part for item in value for part in (numbers_of(item) if isinstance(item, tuple) else [item])
    ]


def test_whole_numbers_in_a_fleet_file_make_no_other_kind_of_numbers():
    other = law_of(
        {"safety_distance_m": 1, "max_speed_m_s": 2, "lag_s": 0},
        kappa_1_1_s=4,
        range_m=8,
        v_perp_m_s=1,
    )
    assert [type(value) for value in numbers_of(other)] == [
        type(value) for value in numbers_of(law_of())
    ]
    fleet = load_fleet("configs/fleets/paper.toml")
    assert isinstance(law_params(fleet, "mav0"), LawParams)
    assert obstacles(fleet) == ()


def pair_of(e, w, command=ZERO_XY, d=0.9, **changes):
    made = NeighbourPair(
        e=Vec2(*e),
        w=Vec2(*w),
        command_m_s2=Vec2(*command),
        intent_m_s=Vec2(*w),
        d_m=d,
        distance_2_m2=e[0] ** 2 + e[1] ** 2,
        crowd_count=0.0,
        is_near=True,
        is_cooperative=True,
        table_index=0,
    )
    return made._replace(**changes)


def test_responsibility_says_how_much_of_the_bound_is_ours():
    still, helping, pushing = ((x, 0.0) for x in (0.0, -1.0, 1.0))

    def bound(policy, command, is_cooperative=True):
        pair = pair_of((0.85, 0.0), (-0.6, 0.0), command, is_cooperative=is_cooperative)
        return distance_row(pair, pair.d_m, law_of(responsibility=policy)).bound_m_s2

    assert bound("half", still) == bound("half", pushing) == bound("half", helping)
    assert bound("full", still) == pytest.approx(2.0 * bound("half", still))
    assert bound("half", still) < bound("shortfall", still) < bound("full", still)
    assert bound("shortfall", helping) < bound("shortfall", still) < bound("shortfall", pushing)
    assert bound("half", still, is_cooperative=False) == bound("full", still)


def distance(params, own_std, their_std, is_cooperative=True, lead_time_s=math.nan):
    neighbour = neighbour_of(ZERO_3, position_std_m=their_std[0], velocity_std_m_s=their_std[1])
    neighbour = neighbour._replace(is_cooperative=is_cooperative, lead_time_s=lead_time_s)
    position_std_m, velocity_std_m_s = own_std
    margin = margin_2(position_std_m, velocity_std_m_s, params.spacing)
    return design_distance(margin, neighbour, params.spacing)


def test_margin_grows_with_the_estimates_errors_and_stays_with_a_mocap():
    params = law_of()
    fixed = params.spacing.safety_distance_m + params.spacing.margin_m
    vision = (0.05, 0.12)
    gps = (0.2, 0.2)
    assert distance(params, MOCAP, MOCAP) == pytest.approx(fixed)
    assert 1.20 < distance(params, vision, vision) < 1.40
    assert distance(params, gps, gps) > 1.6
    assert distance(params, vision, MOCAP) == pytest.approx(distance(params, MOCAP, vision))
    assert distance(params, MOCAP, vision) < distance(params, vision, vision)
    assert distance(law_of(margin="fixed"), vision, vision) == pytest.approx(fixed)


def test_both_vehicles_of_a_pair_keep_the_distance_of_the_one_with_the_longer_lag():
    for quick_lag_s, slow_lag_s in ((0.1, 0.15), (0.1, 0.3), (0.15, 0.27), (0.27, 0.3)):
        quick = law_of({"lag_s": quick_lag_s})
        slow = law_of({"lag_s": slow_lag_s})
        by_quick_m = distance(quick, MOCAP, MOCAP, lead_time_s=slow_lag_s)
        by_slow_m = distance(slow, MOCAP, MOCAP, lead_time_s=quick_lag_s)
        assert by_quick_m == pytest.approx(by_slow_m)
        assert by_slow_m == distance(slow, MOCAP, MOCAP, lead_time_s=slow_lag_s)


def test_margin_of_a_neighbours_lag_is_bounded_and_counts_for_who_cooperates_only():
    quick = law_of({"lag_s": 0.15})
    usual_m = distance(quick, MOCAP, MOCAP)
    for bad_s in (math.nan, -math.inf, -1.0, 0.0):
        assert distance(quick, MOCAP, MOCAP, lead_time_s=bad_s) == usual_m
    assert distance(quick, MOCAP, MOCAP, lead_time_s=math.inf) == pytest.approx(
        usual_m + 0.4 * (LONGEST_LEAD_S - 0.15)
    )
    stranger_m = distance(quick, MOCAP, MOCAP, is_cooperative=False)
    assert distance(quick, MOCAP, MOCAP, False, lead_time_s=1.0) == stranger_m


def test_margin_is_bounded_whatever_is_published_as_accuracy():
    params = law_of()
    fixed = params.spacing.safety_distance_m + params.spacing.margin_m
    for bad in (math.nan, math.inf, -math.inf):
        assert distance(params, (bad, bad), (0.0, bad)) == pytest.approx(fixed), bad
    largest = params.spacing.safety_distance_m + LARGEST_MARGIN_M
    assert distance(params, (1e300, 0.0), (0.0, 0.0)) <= largest


def test_margin_formula_is_the_filtered_noise_of_the_distance_rows():
    """Phi(tau) is the variance of h'' + a_1 h' + a_0 h = noise with correlation time tau,
    simulated.
    """
    params = law_of(kappa_1_1_s=4.0, kappa_2_1_s=8.0, accuracy_time_s=0.5)
    rng = np.random.default_rng(0)
    step = 2e-3
    tau = 0.5
    a_1 = 12.0
    a_0 = 32.0
    noise = np.zeros(4000)
    h = np.zeros(4000)
    rate = np.zeros(4000)
    keep = math.exp(-step / tau)
    for _ in range(2000):
        noise = keep * noise + math.sqrt(1.0 - keep * keep) * rng.normal(size=4000)
        rate = rate + step * (noise - a_1 * rate - a_0 * h)
        h = h + step * rate
    phi = (params.spacing.sigma_position / (5.0 * a_0)) ** 2
    assert np.var(h) == pytest.approx(phi, rel=0.06)


def test_neighbour_that_does_not_cooperate_is_given_more_room():
    params = law_of(uncooperative_margin_m=0.3)
    exact = (0.0, 0.0)
    assert distance(params, exact, exact, False) - distance(
        params, exact, exact, True
    ) == pytest.approx(0.3)


def test_rotation_policies_turn_never_ahead_when_violated_or_always():
    near = [neighbour_of([0.95, 0.0, 0.0])]

    def sideways(policy, east_m_s2):
        out = run(
            np.zeros(3), [0.3, 0.0, 0.0], [east_m_s2, 0.0, 0.0], near, law_of(rotation=policy)
        )
        return abs(out.thrust.thrust_enu_m_s2.y)

    assert sideways("never", 1.0) == pytest.approx(0.0, abs=1e-12)
    assert sideways("violated", 1.0) > 0.1
    assert sideways("always", -4.0) > 0.01  # leaving, and still made to turn
    assert sideways("violated", -4.0) == pytest.approx(0.0, abs=1e-12)
    assert sideways("never", -1.0) == pytest.approx(0.0, abs=1e-12)


def test_vehicles_turn_ahead_only_where_the_ways_that_both_intend_come_too_near():
    """A pair 3 m apart, whose distance row does not bind yet."""

    def sideways(own_intent, their_intent, **law):
        near = [neighbour_of([3.0, 0.0, 0.0], intent_enu_m_s=vec(their_intent))]
        baseline = interface.Baseline(thrust_of([0.0, 0.0, 0.0]), ZERO_3, vec(own_intent))
        state = state_of(np.zeros(3), np.zeros(3))
        out = oist.step(
            oist.initial(), baseline, Motion(ZERO_3, ZERO_3), state, near, (), law_of(**law), 0.02
        )[1]
        return out.status

    east = [1.0, 0.0, 0.0]
    west = [-1.0, 0.0, 0.0]
    north = [0.0, 1.0, 0.0]
    still = [0.0, 0.0, 0.0]
    soft = {"kappa_3_1_s": 0.1}  # the turn reaches far
    assert sideways(east, west, **soft) == LawStatus.SATURATED
    assert sideways(east, still, **soft) == LawStatus.SATURATED  # somebody hovers in the way
    assert sideways(east, west, rotation="violated", **soft) == LawStatus.INACTIVE
    assert sideways(still, still, **soft) == LawStatus.INACTIVE  # nobody circles a parked one
    assert sideways(north, still, **soft) == LawStatus.INACTIVE
    assert sideways(west, east, **soft) == LawStatus.INACTIVE  # they part


def test_a_vehicle_steps_aside_from_a_neighbour_that_it_cannot_outrun():
    def sideways_m_s2(speed_m_s):
        closing = [-speed_m_s, 0.0, 0.0]
        stranger = neighbour_of([1.6, 0.0, 0.0], closing, is_cooperative=False)
        out = run(np.zeros(3), np.zeros(3), np.zeros(3), [stranger], law_of())
        thrust = out.thrust.thrust_enu_m_s2
        assert thrust.x < 0.0
        return abs(thrust.y)

    assert sideways_m_s2(3.0) > 1.0
    assert sideways_m_s2(1.9) < sideways_m_s2(3.0)  # it may flee with nearly this speed


def test_rotation_row_fades_in_with_the_violation():
    """Thrusts on both sides of the one that just violates the distance row give nearly the same
    answer.
    """
    params = law_of()
    near = [neighbour_of([0.95, 0.0, 0.0])]
    out = [
        run(np.zeros(3), np.zeros(3), [east, 0.0, 0.0], near, params)
        for east in np.linspace(0.0, 6.0, 1201)
    ]
    sideways = np.array([one.thrust.thrust_enu_m_s2.y for one in out])
    assert np.abs(np.diff(sideways)).max() < 0.05
    assert np.abs(sideways).max() > 0.2


def test_direction_policies_choose_the_side():
    def sides(direction):
        return [
            turn_sign(Vec2(1.0, 0.0), Vec2(0.0, -1.0), 0.9, is_crowded, direction)
            for is_crowded in (False, True)
        ]

    assert sides(DIRECTION_FIXED) == [1.0, 1.0]
    assert sides(DIRECTION_PAIR) == [-1.0, -1.0]
    assert sides(DIRECTION_CROWD) == [-1.0, 1.0]
    assert sides(DIRECTION_INTENT) == [-1.0, 1.0]


def test_jam_policy_slows_the_pursuit_or_does_not():
    jammed = oist.initial()._replace(relaxed_share=0.5)
    assert oist.speed_share(jammed, law_of()) < 0.5
    assert oist.speed_share(jammed, law_of(jam="ignore")) == 1.0


def test_a_vehicle_held_for_long_calls_for_a_roundabout_and_one_that_gets_on_does_not():
    params = law_of()

    def counts(velocity):
        memory = oist.initial()
        state = state_of(np.zeros(3), velocity)
        wall = [neighbour_of([0.85, 0.0, 0.0])]
        baseline = interface.Baseline(thrust_of([3.0, 0.0, 0.0]), ZERO_3, EAST)
        found = []
        for _ in range(500):
            memory, out = oist.step(
                memory, baseline, Motion(ZERO_3, vec(velocity)), state, wall, (), params, 0.02
            )
            found.append(out.crowd_count)
        return np.array(found)

    held = counts(ZERO_3)
    calling = held >= params.gains.crowd_count
    assert np.flatnonzero(calling)[0] == pytest.approx(oist.HELD_S / 0.02, abs=2)
    assert not calling[-1]  # and stops when it has had its time
    assert (counts(0.5 * np.array(EAST)) < 2.0).all()


def test_speed_is_limited_while_avoiding_but_separation_comes_first():
    params = law_of({"max_speed_m_s": 1.0}, rotation="never")
    fast = [1.2, 0.0, 0.0]
    out = run(
        np.zeros(3), fast, [2.0, 0.0, 0.0], [neighbour_of([0.3, 0.8, 0.0], [1.2, 0.0, 0.0])], params
    )
    assert out.status == LawStatus.SATURATED
    assert out.thrust.thrust_enu_m_s2.x < 0.0  # braked towards 1 m/s
    out = run(
        np.zeros(3), fast, np.zeros(3), [neighbour_of([-0.5, 0.0, 0.0], [3.0, 0.0, 0.0])], params
    )
    # pushed on from behind, faster than the limit: it goes
    assert out.thrust.thrust_enu_m_s2.x > 0.0


def test_unequal_lead_times_are_compared_at_the_same_moment():
    """A neighbour that published its state for its own longer lag is avoided as the same one with
    ours.
    """
    p = np.array([1.3, 0.0, 0.0])
    v = np.array([-0.7, 0.1, 0.0])
    u = np.array([-0.5, 0.2, 0.0])
    published = {}
    for lead in (0.15, 0.27, 0.05):
        neighbour = neighbour_of(p, v, u, lead_time_s=lead)._replace(
            predicted_position_enu_m=vec(p + lead * v + 0.5 * lead**2 * u),
            predicted_velocity_enu_m_s=vec(v + lead * u),
        )
        out = run(np.zeros(3), [0.7, 0.0, 0.0], [1.0, 0.0, 0.0], [neighbour], law_of())
        published[lead] = out.thrust.thrust_enu_m_s2
    np.testing.assert_allclose(published[0.27], published[0.15], atol=1e-9)
    np.testing.assert_allclose(published[0.05], published[0.15], atol=1e-9)
