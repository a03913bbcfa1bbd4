"""Many flights at once, from start to arrival, tick by tick.

In each tick the vehicles sense, receive messages, control and publish. The control of a vehicle is
its pipeline, which computes trajectory, law and attitude. Then the emulator's physics moves the
vehicles, and the metrics judge their true positions. Arrays hold F flights of N vehicles. When a
flight is over, its row is removed from all arrays (``keep``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from onboard.arrays import Array, BoolArray
from onboard.avoidance.params import Capsule
from onboard.config.fleet import FleetConfig
from onboard.control import pipeline, trajectory
from onboard.rollout import batch, layouts
from onboard.rollout.own_law_fleet import OwnLawFleet
from onboard.rollout.rows import Rows
from sitl.monte_carlo import worlds
from sitl.monte_carlo.campaign_settings import Setup
from sitl.monte_carlo.member_lie import MemberLies, shifted
from sitl.monte_carlo.metrics import FlightMetrics, FlightOutcome
from sitl.monte_carlo.mixed_fleet import MixedFleet
from sitl.monte_carlo.noise import FlightNoise
from sitl.monte_carlo.orders import FlightOrders
from sitl.monte_carlo.radio import Radio
from sitl.monte_carlo.scenarios import FlightPlan, OtherLaw, person_radii_m
from sitl.monte_carlo.sensing import sensing
from sitl.monte_carlo.vehicles import TICK_S

MakeController = Callable[
    [Sequence[pipeline.PipelineParams], Array, Sequence[Capsule]], batch.Controller
]
# a flight has failed if it takes more than this multiple of its straight-line time
_TIMES_STRAIGHT = 5.5
_ALONE_SPARE_S = 20.0  # time added to the expected time of a straight-line flight

# names of the fields of position and velocity, in rows of states and in rows of the law
_OF_STATE = ("position_enu_m", "velocity_enu_m_s")
_OF_LAW = ("predicted_position_enu_m", "predicted_velocity_enu_m_s")

# (setup, physics, scenario, seed, bytes of its places) -> makespan of the straight-line flight
_StraightKey = tuple[str, str, str, int, bytes]
_STRAIGHT_S: dict[_StraightKey, float] = {}


@dataclass(frozen=True, slots=True)
class Flown:
    """A plan and the outcome of its flight."""

    plan: FlightPlan
    outcome: FlightOutcome
    # time that the slowest vehicle needs without avoidance; inf if it does not arrive
    straight_line_s: float
    law_refusal: str = ""  # why Covey's law took over from a user's own law; empty: it did not


def fly(
    plans: Sequence[FlightPlan],
    setup: Setup,
    *,
    controller: MakeController | None = None,
    physics: str = worlds.DEFAULT,
    has_trace: bool = False,
) -> list[Flown]:
    """Fly plans and return their outcomes; each outcome depends on its own plan only.

    Args:
        plans: the plans, all of the same number of vehicles.
        setup: fleet, law, errors and perturbation of all flights.
        controller: makes the control of all vehicles; by default from the law of the fleet.
        physics: name of the physics, of :data:`sitl.monte_carlo.worlds.WORLDS`.
        has_trace: whether the outcomes hold samples of the flight.
    """
    limits_s = _straight_limits_s(plans, setup)
    straight_s = straight_line_s(plans, setup, physics=physics)
    longest_s = []
    for plan, one_straight_s, limit_s in zip(plans, straight_s, limits_s, strict=True):
        if plan.longest_s:
            longest_s.append(plan.longest_s)
        else:
            longest_s.append(_TIMES_STRAIGHT * min(one_straight_s, limit_s))

    outcomes, refusals = _fly(
        plans,
        setup,
        longest_s,
        controller=controller,
        physics=physics,
        has_trace=has_trace,
    )

    flown = []
    for number, plan in enumerate(plans):
        flown.append(
            Flown(
                plan=plan,
                outcome=outcomes[number],
                straight_line_s=straight_s[number],
                law_refusal=refusals.get(number, ""),
            )
        )
    return flown


def straight_line_s(
    plans: Sequence[FlightPlan], setup: Setup, *, physics: str = worlds.DEFAULT
) -> list[float]:
    """Return the makespans [s] of the same flights without avoidance: straight lines to the goals.

    Noise and vehicles are the same, but the law is off and no messages are sent. The makespans do
    not depend on the law, its values or the messages, so each is flown once per process.
    """
    # messages do not matter here, so their settings must not make two setups different
    without_radio = replace(setup.perturbation, delay_s=0.0, loss_share=0.0)
    alone = replace(setup, law="off", law_table={}, perturbation=without_radio)
    keys = [_straight_key(alone, plan, physics) for plan in plans]

    missing = [plan for plan, key in zip(plans, keys, strict=True) if key not in _STRAIGHT_S]
    if missing:
        limits_s = _straight_limits_s(missing, setup)
        outcomes, _ = _fly(missing, alone, limits_s, physics=physics, is_alone=True)
        for plan, outcome in zip(missing, outcomes, strict=True):
            _STRAIGHT_S[_straight_key(alone, plan, physics)] = outcome.makespan_s

    return [_STRAIGHT_S[key] for key in keys]


def _straight_key(alone: Setup, plan: FlightPlan, physics: str) -> _StraightKey:
    """Return the key of a straight-line flight; scenes with the same name may differ in goals."""
    places = plan.start_enu_m.tobytes() + plan.goals_enu_m.tobytes()
    return repr(alone), physics, plan.scenario, plan.seed, places


def _straight_limits_s(plans: Sequence[FlightPlan], setup: Setup) -> list[float]:
    """Return the times [s] after which straight-line flights are given up."""
    vehicles = setup.fleet(plans[0].count).vehicles.values()
    lowest_speed_m_s = min(vehicle.max_speed_m_s for vehicle in vehicles)
    lowest_acceleration_m_s2 = min(vehicle.max_acceleration_m_s2 for vehicle in vehicles)
    params = trajectory.TrajectoryParams(float(lowest_speed_m_s), float(lowest_acceleration_m_s2))

    limits_s = []
    for plan in plans:
        shortest_s = 0.0
        for longest_leg_m in plan.legs_m.max(axis=-1).tolist():
            shortest_s += trajectory.shortest_duration_s(longest_leg_m, 0.0, params)
        expected_s = max(shortest_s, plan.duration_s, plan.earliest_s)
        limits_s.append(expected_s + _ALONE_SPARE_S)
    return limits_s


def _fly(
    plans: Sequence[FlightPlan],
    setup: Setup,
    longest_s: Sequence[float],
    *,
    controller: MakeController | None = None,
    physics: str = worlds.DEFAULT,
    is_alone: bool = False,
    has_trace: bool = False,
) -> tuple[list[FlightOutcome], dict[int, str]]:
    """Fly plans together.

    Args:
        plans: the plans, all of the same number of vehicles.
        setup: fleet, law, errors and perturbation of all flights.
        longest_s: time of each flight after which it is ended.
        controller: makes the control of all vehicles; by default from the law of the fleet.
        physics: name of the physics.
        is_alone: whether vehicles get no messages, know no obstacles and do not lie.
        has_trace: whether the outcomes hold samples of the flight.

    Returns:
        The outcomes, and by index of the flight the reason why a user's own law was refused.
    """
    count = plans[0].count
    fleet = setup.fleet(count)
    vehicles = list(fleet.vehicles.values())
    start = np.stack([plan.start_enu_m for plan in plans])  # (F, N, 3)
    noise = FlightNoise([plan.seed for plan in plans], count, has_links=not is_alone)

    # velocities (F, N, 3) of intruders, NaN for multirotors
    scripted = np.full(start.shape, np.nan)
    for f, plan in enumerate(plans):
        if plan.intruder_m_s is not None:
            scripted[f, -1] = plan.intruder_m_s

    # only fleets whose file lets vehicles fly above each other feel the rotors' wash
    wash_m = 0.0
    if fleet.fleet.vertical_separation_m is not None:
        wash_m = fleet.fleet.body_diameter_m

    make_world = worlds.world_of(physics)
    world = make_world(
        vehicles=vehicles,
        start_enu_m=start,
        scripted=scripted,
        noise=noise,
        perturbation=setup.perturbation,
        seeds=[plan.seed for plan in plans],
        wash_diameter_m=wash_m,
    )
    truth = world.truth()
    sensors = sensing(setup.errors, vehicles, truth, noise)

    obstacles = () if is_alone else plans[0].obstacles
    make_controller = _controller(fleet) if controller is None else controller
    pipelines = make_controller(params_of(fleet), start, obstacles)
    if plans[0].other_law is not None and not is_alone:
        pipelines = _with_other_law(pipelines, plans[0].other_law, setup, start, obstacles)

    metrics = FlightMetrics(
        plans=plans,
        longest_s=longest_s,
        fleet=fleet,
        errors=setup.errors,
        gusts_m_s2=[setup.perturbation.gusts_m_s2(vehicle.drag_1_s) for vehicle in vehicles],
        start_enu_m=start,
        has_trace=has_trace,
    )
    orders = FlightOrders(plans)
    lies = MemberLies(plans)
    has_lies = lies.has_any and not is_alone
    radio: Radio | None = None

    # both (F, N): the thrust sent last, and the hover thrust that the pipelines estimate
    nominal_hover = [vehicle.hover_thrust_frac for vehicle in vehicles]
    throttle = np.broadcast_to(nominal_hover, start.shape[:2])
    hover = throttle

    # each pass is one tick of all flights under way; F falls when a flight ends
    while True:
        # the vehicles sense; liars change what they publish, or also what they believe
        normals, link_draws = noise.next()
        states = sensors.update(truth, normals, throttle, hover)
        published_states = states
        # offset of the positions that liars publish, and its rate of change
        offset_m = np.zeros_like(start)
        velocity_m_s = offset_m
        if has_lies:
            offset_m, velocity_m_s = lies.offsets(metrics.time_s)
            published_states = shifted(states, offset_m, velocity_m_s, _OF_STATE)
            # a liar that believes its false position also flies by it
            states = np.where(lies.is_believed()[:, None], published_states, states)

        # they receive the messages of earlier ticks
        if radio is None and not is_alone:
            radio = Radio(
                states,
                np.isfinite(scripted).all(-1),
                setup.perturbation,
                fleet.expected_radio.lateness_s,
                radius_m=person_radii_m(plans),
            )

        is_frozen, is_mute = orders.lost(metrics.time_s)
        neighbours = layouts.NEIGHBOUR.rows((*start.shape[:2], 0))
        if radio is not None:
            neighbours = radio.receive(link_draws, is_mute, is_frozen, sensors.tracked())

        # they control and publish; the autopilot of a frozen vehicle holds position without
        # avoiding
        has_neighbours = ~(is_frozen | orders.is_blind)
        is_present = np.broadcast_to(has_neighbours[..., None], neighbours.shape)
        goals = orders.goals(is_frozen, truth)
        ticks = pipelines.step(states, goals, neighbours, is_present, TICK_S)
        if radio is not None:
            published_ticks = _published_ticks(ticks, offset_m, velocity_m_s, lies.is_believed())
            radio.publish(published_states, published_ticks)

        # the physics moves them
        throttle = ticks["attitude"]["thrust_frac"]
        hover = ticks["hover_thrust_frac"]
        world.advance(ticks["attitude"]["quaternion_wxyz"], throttle, normals)
        truth = world.truth()

        # the metrics judge them; the law gives the most avoided neighbour's index among the
        # received neighbours, but the metrics need its index in the fleet
        most_avoided = ticks["law"]["active_neighbour"].astype(np.int64)
        most_avoided_vehicle = most_avoided
        if radio is not None:
            most_avoided_vehicle = radio.vehicle(most_avoided)
        going_on = metrics.update(truth, ticks, most_avoided_vehicle)
        orders.advance(metrics)
        if len(going_on) == len(start):
            continue
        if not len(going_on):
            # only the control by a user's own law has refusals
            return metrics.outcomes, getattr(pipelines, "refusals", {})

        # the rows of the flights that have ended are removed from all arrays
        start = start[going_on]
        throttle = throttle[going_on]
        hover = hover[going_on]
        for part in (noise, sensors, pipelines, world, metrics, orders, lies):
            part.keep(going_on)
        if radio is not None:
            radio.keep(going_on)
        truth = world.truth()


def _published_ticks(
    ticks: Rows, offset_m: Array, velocity_m_s: Array, is_believed: BoolArray
) -> Rows:
    """Return the ticks as published; a liar's prediction is as false as its position.

    A vehicle that believes its false position already predicts from it, so its prediction needs no
    change.
    """
    is_false = offset_m.any(-1) & ~is_believed[:, None]
    if not is_false.any():
        return ticks
    false_ticks = ticks.copy()
    false_ticks["law"] = shifted(ticks["law"], offset_m, velocity_m_s, _OF_LAW)
    return np.where(is_false, false_ticks, ticks)


def _with_other_law(
    first: batch.Controller,
    other: OtherLaw,
    setup: Setup,
    start_enu_m: Array,
    obstacles: Sequence[Capsule],
) -> MixedFleet:
    """Return the control of a fleet in which some vehicles use another law."""
    count = start_enu_m.shape[1]
    fleet = replace(setup, law=other.name).fleet(count)
    return MixedFleet(
        first=first,
        second=_controller(fleet)(params_of(fleet), start_enu_m, obstacles),
        is_of_second=np.isin(np.arange(count), other.vehicles),
    )


def params_of(fleet: FleetConfig) -> list[pipeline.PipelineParams]:
    """Return the parameters of the pipelines of all vehicles of a fleet."""
    return [pipeline.pipeline_params(fleet, name) for name in fleet.vehicles]


def _controller(fleet: FleetConfig) -> MakeController:
    """Return the class that controls the vehicles of a fleet by its law."""
    if fleet.own_law is None:
        return batch.FleetPipeline
    return partial(OwnLawFleet, fleet.own_law)
