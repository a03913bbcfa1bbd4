"""Many flights at once, from start to arrival, tick by tick.

In each tick the vehicles sense, receive messages, control and publish; then the emulator moves them
and the metrics judge where they truly are. Arrays hold F flights of N vehicles. Flights that are
over leave all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance.params import Capsule
from onboard.config.fleet import FleetConfig
from onboard.control import pipeline, trajectory
from onboard.rollout import batch
from onboard.rollout.own_law_fleet import OwnLawFleet
from onboard.rollout.rows import Rows
from sitl.monte_carlo.campaign_settings import Setup
from sitl.monte_carlo.member_lie import MemberLies, shifted
from sitl.monte_carlo.metrics import FlightMetrics, FlightOutcome
from sitl.monte_carlo.noise import FlightNoise
from sitl.monte_carlo.radio import Radio
from sitl.monte_carlo.scenarios import FlightPlan
from sitl.monte_carlo.sensing import sensing
from sitl.monte_carlo.vehicles import TICK_S, Physics, TrueMotions

MakeController = Callable[
    [Sequence[pipeline.PipelineParams], Array, Sequence[Capsule]], batch.Controller
]
_TIMES_STRAIGHT = 5.5  # a flight that takes longer than so many times the lone one has failed
_ALONE_SPARE_S = 20.0
_STOP_S = 0.5  # at top speed the limits of acceleration and the lag need about so much to stop

# position and velocity, by their names
_OF_STATE = ("position_enu_m", "velocity_enu_m_s")
_OF_LAW = ("predicted_position_enu_m", "predicted_velocity_enu_m_s")

# makespans of lone flights by setup, scenario and seed
_STRAIGHT_S: dict[tuple[str, str, int], float] = {}


@dataclass(frozen=True, slots=True)
class Flown:
    """A plan and what came of it."""

    plan: FlightPlan
    outcome: FlightOutcome
    straight_line_s: float  # of its slowest vehicle alone; inf: it does not arrive even alone
    law_refusal: str = ""  # why a vehicle went on by Covey's law in the place of somebody's own


def fly(
    plans: Sequence[FlightPlan],
    setup: Setup,
    *,
    controller: MakeController | None = None,
    has_trace: bool = False,
) -> list[Flown]:
    """Fly plans of equally many vehicles; each outcome depends on its own plan only.

    Straight-line times are flown too, see :func:`straight_line_s`.
    """
    patience = _patience_s(plans, setup)
    straight = straight_line_s(plans, setup)
    longest = []
    for alone_s, patience_s in zip(straight, patience, strict=True):
        longest.append(_TIMES_STRAIGHT * min(alone_s, patience_s))

    outcomes, refusals = _fly(plans, setup, longest, controller=controller, has_trace=has_trace)

    flown = []
    for number, plan in enumerate(plans):
        flown.append(
            Flown(
                plan=plan,
                outcome=outcomes[number],
                straight_line_s=straight[number],
                law_refusal=refusals.get(number, ""),
            )
        )
    return flown


def straight_line_s(plans: Sequence[FlightPlan], setup: Setup) -> list[float]:
    """Return the makespans of the same flights, noise and vehicles where nobody knows of anybody.

    The law is off. The times do not depend on the law, its values or the messages, so they are
    flown once per process.
    """
    unheard = replace(setup.perturbation, delay_s=0.0, loss_share=0.0)
    alone = replace(setup, law="off", law_table={}, perturbation=unheard)
    keys = [(repr(alone), plan.scenario, plan.seed) for plan in plans]

    missing = [plan for plan, key in zip(plans, keys, strict=True) if key not in _STRAIGHT_S]
    if missing:
        outcomes, _ = _fly(missing, alone, _patience_s(missing, setup), is_alone=True)
        for plan, outcome in zip(missing, outcomes, strict=True):
            _STRAIGHT_S[repr(alone), plan.scenario, plan.seed] = outcome.makespan_s

    return [_STRAIGHT_S[key] for key in keys]


def _patience_s(plans: Sequence[FlightPlan], setup: Setup) -> list[float]:
    """Return the times after which lone flights will not arrive any more."""
    vehicles = setup.fleet(plans[0].count).vehicles.values()
    slowest_m_s = min(vehicle.max_speed_m_s for vehicle in vehicles)
    laziest_m_s2 = min(vehicle.max_acceleration_m_s2 for vehicle in vehicles)
    params = trajectory.TrajectoryParams(float(slowest_m_s), float(laziest_m_s2))

    patience = []
    for plan in plans:
        farthest_m = float(np.linalg.norm(plan.goal_enu_m - plan.start_enu_m, axis=1).max())
        shortest_s = trajectory.shortest_duration_s(farthest_m, params)
        expected_s = max(shortest_s, plan.duration_s, plan.earliest_s)
        patience.append(expected_s + _ALONE_SPARE_S)
    return patience


def _fly(
    plans: Sequence[FlightPlan],
    setup: Setup,
    longest_s: Sequence[float],
    *,
    controller: MakeController | None = None,
    is_alone: bool = False,
    has_trace: bool = False,
) -> tuple[list[FlightOutcome], dict[int, str]]:
    """Return the outcomes, and the reasons of the flights in which somebody's law was refused."""
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

    wash_m = 0.0
    if fleet.fleet.vertical_separation_m is not None:
        wash_m = fleet.fleet.body_diameter_m

    world = Physics(
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

    make_controller = controller or _controller(fleet)
    params = [pipeline.pipeline_params(fleet, vehicle.name) for vehicle in vehicles]
    obstacles = () if is_alone else plans[0].obstacles
    pilots = make_controller(params, start, obstacles)

    metrics = FlightMetrics(
        plans=plans,
        longest_s=longest_s,
        fleet=fleet,
        errors=setup.errors,
        gusts_m_s2=[setup.perturbation.gusts_m_s2(vehicle.drag_1_s) for vehicle in vehicles],
        start_enu_m=start,
        has_trace=has_trace,
    )
    orders = _Orders(plans)
    lies = MemberLies(plans)
    tells_lies = lies.has_any and not is_alone
    radio: Radio | None = None

    # both (F, N): as sent last, and as the pipelines estimate it
    nominal_hover = [vehicle.hover_thrust_frac for vehicle in vehicles]
    throttle = np.broadcast_to(nominal_hover, start.shape[:2])
    hover = throttle

    while True:
        normals, link_draws = noise.next()
        states = sensors.update(truth, normals, throttle, hover)
        told = states
        offset_m = velocity_m_s = np.zeros_like(start)
        if tells_lies:
            offset_m, velocity_m_s = lies.offsets(metrics.time_s)
            told = shifted(states, offset_m, velocity_m_s, _OF_STATE)
            states = np.where(lies.is_believed()[:, None], told, states)

        if radio is None and not is_alone:
            is_intruder = np.isfinite(scripted).all(-1)
            radio = Radio(states, is_intruder, setup.perturbation, fleet.expected_radio.lateness_s)

        is_frozen, is_mute = orders.lost(metrics.time_s)
        neighbours = batch.NEIGHBOUR.rows((*start.shape[:2], 0))
        if radio is not None:
            neighbours = radio.receive(link_draws, is_mute, is_frozen, sensors.tracked())

        # the autopilot of a frozen one holds by itself, and avoids nobody
        is_present = np.broadcast_to(~is_frozen[..., None], neighbours.shape)
        goals = orders.goals(is_frozen, truth)
        ticks = pilots.step(states, goals, neighbours, is_present, TICK_S)
        if radio is not None:
            radio.publish(told, _as_told(ticks, offset_m, velocity_m_s, lies.is_believed()))

        throttle = ticks["attitude"]["thrust_frac"]
        hover = ticks["hover_thrust_frac"]
        world.advance(ticks["attitude"]["quaternion_wxyz"], throttle, normals)
        truth = world.truth()

        active = ticks["law"]["active_neighbour"].astype(np.int64)
        if radio is not None:
            active = radio.vehicle(active)
        going_on = metrics.update(truth, ticks, active)

        if len(going_on) == len(start):
            continue
        if not len(going_on):
            return metrics.outcomes, getattr(pilots, "refusals", {})

        start = start[going_on]
        throttle = throttle[going_on]
        hover = hover[going_on]
        for part in (noise, sensors, pilots, world, metrics, orders, lies):
            part.keep(going_on)
        if radio is not None:
            radio.keep(going_on)
        truth = world.truth()


def _as_told(ticks: Rows, offset_m: Array, velocity_m_s: Array, is_believed: BoolArray) -> Rows:
    """Return the ticks as a liar tells them: its prediction is off, as its position is.

    Who believes its false position predicts from it already.
    """
    is_off = offset_m.any(-1) & ~is_believed[:, None]
    if not is_off.any():
        return ticks
    told = ticks.copy()
    told["law"] = shifted(ticks["law"], offset_m, velocity_m_s, _OF_LAW)
    return np.where(is_off, told, ticks)


def _controller(fleet: FleetConfig) -> MakeController:
    """Return what makes the control of a fleet under its law."""
    if fleet.own_law is None:
        return batch.FleetPipeline
    return partial(OwnLawFleet, fleet.own_law)


class _Orders:
    """Goals of the flights, and who is lost from when on; arrays (F, N, ...)."""

    def __init__(self, plans: Sequence[FlightPlan]) -> None:
        count = plans[0].count
        self._goal = np.stack([plan.goal_enu_m for plan in plans])
        self._duration = np.repeat([[plan.duration_s] for plan in plans], count, axis=1)

        shape = self._goal.shape[:2]
        self._sequence = np.zeros(shape, np.int64)
        self._lost_at = np.full(shape, np.inf)
        self._freezes = np.zeros(shape, bool)
        self._mutes = np.zeros(shape, bool)

        for f, plan in enumerate(plans):
            if plan.lost is not None:
                index, time_s, kind = plan.lost
                self._lost_at[f, index] = time_s
                self._freezes[f, index] = kind != "silent"
                self._mutes[f, index] = kind != "frozen"

    def lost(self, time_s: float) -> tuple[BoolArray, BoolArray]:
        """Return which vehicles (F, N) stand still and avoid nobody, and which send nothing."""
        is_lost = np.asarray(time_s >= self._lost_at)
        return is_lost & self._freezes, is_lost & self._mutes

    def goals(self, is_frozen: BoolArray, truth: TrueMotions) -> Rows:
        """Return the goals of this tick.

        A vehicle that has just frozen stops where it comes to rest, and stays.
        """
        has_just_frozen = is_frozen & (self._sequence == 0)
        if has_just_frozen.any():
            resting = truth.position_enu_m + _STOP_S * truth.velocity_enu_m_s
            self._goal = np.where(has_just_frozen[..., None], resting, self._goal)
            self._duration = np.where(has_just_frozen, 0.0, self._duration)
            self._sequence = np.where(has_just_frozen, 1, self._sequence)

        goals = batch.GOAL.rows(self._sequence.shape)
        goals["position_enu_m"] = self._goal
        goals["duration_s"] = self._duration
        goals["sequence"] = self._sequence
        return goals

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._goal = self._goal[flights]
        self._duration = self._duration[flights]
        self._sequence = self._sequence[flights]
        self._lost_at = self._lost_at[flights]
        self._freezes = self._freezes[flights]
        self._mutes = self._mutes[flights]
