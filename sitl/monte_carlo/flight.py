"""Many flights at once, from start to arrival: sense, hear, control, publish, move, measure; tick
by tick.
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
from sitl.monte_carlo.metrics import FlightMetrics, Outcome
from sitl.monte_carlo.noise import Noise
from sitl.monte_carlo.radio import Radio
from sitl.monte_carlo.scenarios import Plan
from sitl.monte_carlo.sensing import sensing
from sitl.monte_carlo.settings import Setup
from sitl.monte_carlo.vehicles import TICK_S, Physics, Truth

MakeController = Callable[
    [Sequence[pipeline.PipelineParams], Array, Sequence[Capsule]], batch.Controller
]
_TIMES_STRAIGHT = 5.5  # a flight that takes longer than so many times the lone one has failed
_ALONE_SPARE_S = 20.0
_STOP_S = 0.5  # at top speed the limits of acceleration and the lag need about so much to stop


_STRAIGHT_S: dict[tuple[str, str, int], float] = {}


@dataclass(frozen=True, slots=True)
class Flown:
    """A plan, what came of it, and how long its slowest vehicle takes alone (inf: it does not
    arrive even alone).
    """

    plan: Plan
    outcome: Outcome
    straight_line_s: float
    law_refusal: str = ""  # why a vehicle went on by Covey's law in the place of somebody's own


def fly(
    plans: Sequence[Plan],
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
    longest = [_TIMES_STRAIGHT * min(times) for times in zip(straight, patience, strict=True)]
    flown, refusals = _fly(plans, setup, longest, controller=controller, has_trace=has_trace)
    return [
        Flown(plan, outcome, time, refusals.get(number, ""))
        for number, (plan, outcome, time) in enumerate(zip(plans, flown, straight, strict=True))
    ]


def straight_line_s(plans: Sequence[Plan], setup: Setup) -> list[float]:
    """Makespans of the same flights, noise and vehicles with the law off, where nobody knows of
    anybody.

    They do not depend on the law, its values or the messages, so they are flown once per process.
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


def _patience_s(plans: Sequence[Plan], setup: Setup) -> list[float]:
    """Time after which a lone flight will not arrive any more."""
    vehicles = setup.fleet(plans[0].count).vehicles.values()
    params = trajectory.TrajectoryParams(
        float(min(vehicle.max_speed_m_s for vehicle in vehicles)),
        float(min(vehicle.max_acceleration_m_s2 for vehicle in vehicles)),
    )
    reach = [
        float(np.linalg.norm(plan.goal_enu_m - plan.start_enu_m, axis=1).max()) for plan in plans
    ]
    return [
        max(trajectory.shortest_duration_s(far, params), plan.duration_s, plan.earliest_s)
        + _ALONE_SPARE_S
        for far, plan in zip(reach, plans, strict=True)
    ]


def _fly(
    plans: Sequence[Plan],
    setup: Setup,
    longest_s: Sequence[float],
    *,
    controller: MakeController | None = None,
    is_alone: bool = False,
    has_trace: bool = False,
) -> tuple[list[Outcome], dict[int, str]]:
    """Return the outcomes, and for the flights in which somebody's own law was refused, the reason."""
    count = plans[0].count
    fleet = setup.fleet(count)
    vehicles = list(fleet.vehicles.values())
    start = np.stack([plan.start_enu_m for plan in plans])
    noise = Noise([plan.seed for plan in plans], count, has_links=not is_alone)
    scripted = np.full(start.shape, np.nan)
    for f, plan in enumerate(plans):
        if plan.intruder_m_s is not None:
            scripted[f, -1] = plan.intruder_m_s
    wash_m = 0.0 if fleet.fleet.vertical_separation_m is None else fleet.fleet.body_diameter_m
    world = Physics(vehicles, start, scripted, noise, setup.perturbation, wash_m)
    truth = world.truth()
    senses = sensing(setup.errors, vehicles, truth, noise)
    pilots = (controller or _controller(fleet))(
        [pipeline.pipeline_params(fleet, vehicle.name) for vehicle in vehicles],
        start,
        () if is_alone else plans[0].obstacles,
    )
    throttle = np.broadcast_to([vehicle.hover_thrust_frac for vehicle in vehicles], start.shape[:2])
    hover = throttle
    metrics = FlightMetrics(plans, longest_s, fleet, setup.errors, start, has_trace=has_trace)
    orders = _Orders(plans)
    radio: Radio | None = None
    while True:
        normals, link_draws = noise.next()
        states = senses.update(truth, normals, throttle, hover)
        if radio is None and not is_alone:
            is_stranger = np.isfinite(scripted).all(-1)
            radio = Radio(states, is_stranger, setup.perturbation, fleet.expected_radio.lateness_s)
        frozen, mute = orders.lost(metrics.time_s)
        neighbours = batch.NEIGHBOUR.rows((*start.shape[:2], 0))
        if radio is not None:
            neighbours = radio.receive(link_draws, mute, frozen, senses.tracked())
        # the autopilot of a frozen one holds by itself, and avoids nobody
        is_present = np.broadcast_to(~frozen[..., None], neighbours.shape)
        ticks = pilots.step(states, orders.goals(frozen, truth), neighbours, is_present, TICK_S)
        if radio is not None:
            radio.publish(states, ticks)
        throttle, hover = ticks["attitude"]["thrust_frac"], ticks["hover_thrust_frac"]
        world.advance(ticks["attitude"]["quaternion_wxyz"], throttle, normals)
        truth = world.truth()
        active = ticks["law"]["active_neighbour"].astype(np.int64)
        going_on = metrics.update(truth, ticks, active if radio is None else radio.vehicle(active))
        if len(going_on) == len(start):
            continue
        if not len(going_on):
            return metrics.outcomes, getattr(pilots, "refusals", {})
        start, throttle, hover = start[going_on], throttle[going_on], hover[going_on]
        for part in (
            noise,
            senses,
            pilots,
            world,
            metrics,
            orders,
            *(() if radio is None else (radio,)),
        ):
            part.keep(going_on)
        truth = world.truth()


def _controller(fleet: FleetConfig) -> MakeController:
    """Return what makes the control of a fleet under its law."""
    return batch.FleetPipeline if fleet.own_law is None else partial(OwnLawFleet, fleet.own_law)


class _Orders:
    """Goals of the flights, and who is lost from when on."""

    def __init__(self, plans: Sequence[Plan]) -> None:
        count = plans[0].count
        self._goal = np.stack([plan.goal_enu_m for plan in plans])
        self._duration = np.repeat([[plan.duration_s] for plan in plans], count, axis=1)
        self._sequence = np.zeros(self._goal.shape[:2], np.int64)
        self._lost_at = np.full(self._goal.shape[:2], np.inf)
        self._freezes, self._mutes = (np.zeros(self._goal.shape[:2], bool) for _ in range(2))
        for f, plan in enumerate(plans):
            if plan.lost is not None:
                index, time_s, kind = plan.lost
                self._lost_at[f, index] = time_s
                self._freezes[f, index], self._mutes[f, index] = kind != "silent", kind != "frozen"

    def lost(self, time_s: float) -> tuple[BoolArray, BoolArray]:
        """Return the vehicles that stand still and avoid nobody, and those that send nothing more,
        (F, N) each.
        """
        is_lost = np.asarray(time_s >= self._lost_at)
        return is_lost & self._freezes, is_lost & self._mutes

    def goals(self, frozen: BoolArray, truth: Truth) -> Rows:
        """Return the goals of this tick; a vehicle that has just frozen stops where it comes to
        rest, and stays.
        """
        fresh = frozen & (self._sequence == 0)
        if fresh.any():
            self._goal = np.where(
                fresh[..., None],
                truth.position_enu_m + _STOP_S * truth.velocity_enu_m_s,
                self._goal,
            )
            self._duration = np.where(fresh, 0.0, self._duration)
            self._sequence = np.where(fresh, 1, self._sequence)
        goals = batch.GOAL.rows(self._sequence.shape)
        goals["position_enu_m"], goals["duration_s"], goals["sequence"] = (
            self._goal,
            self._duration,
            self._sequence,
        )
        return goals

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._goal, self._duration = self._goal[flights], self._duration[flights]
        self._sequence, self._lost_at = self._sequence[flights], self._lost_at[flights]
        self._freezes, self._mutes = self._freezes[flights], self._mutes[flights]
