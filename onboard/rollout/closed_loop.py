"""The closed loop of the pipeline over emulated vehicles, batched over flights and vehicles.

Each vehicle flies on its own estimate from noisy, late mocap samples, and receives the others late
and with losses. Flights are repeatable: each draws from its own seed, alone or in a batch.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array, BoolArray
from onboard.avoidance.params import Capsule, obstacles
from onboard.config.fleet import FleetConfig
from onboard.config.pair_separation import separations_m
from onboard.control import pipeline
from onboard.estimation import kalman
from onboard.rollout import batch
from onboard.rollout.rows import Rows, floats
from onboard.rollout.vehicle_model import Noise, Perturbation, Plant, VehicleModels, plant_of
from onboard.types import TICK_S


@dataclass(frozen=True, slots=True)
class Scenario:
    """Legs that F flights of N vehicles fly one after the other; a leg ends when all have arrived,
    or too late.
    """

    start_enu_m: Array  # (F, N, 3)
    legs_enu_m: Array  # (F, L, N, 3) goals
    duration_s: Array  # (L,) commanded for each leg
    timeout_s: float = 40.0  # of each leg
    is_parked: tuple[bool, ...] = ()  # (N,) stands on the ground all the while; empty: nobody does
    arrival_m: float = 0.15  # a vehicle has arrived when it has stayed so near ...
    settle_s: float = 1.0  # ... for this long


@dataclass(frozen=True, slots=True)
class FleetModel:
    """The vehicles of a fleet as :func:`fly` takes them."""

    params: Sequence[pipeline.PipelineParams]  # N
    plants: Sequence[Plant]  # N
    obstacles: tuple[Capsule, ...] = ()
    height_share: float = 0.0  # what a metre of height counts in a separation


@dataclass(frozen=True, slots=True)
class RolloutResult:
    """Outcome of F flights."""

    # (F, L) when the last vehicle arrived, after the leg's start; inf: not in time
    arrival_s: Array
    # (T, F, N, 3) true positions after each tick, until the last flight has ended
    trace_enu_m: Array
    height_share: float = 0.0

    @property
    def is_success(self) -> BoolArray:
        """Whether every leg arrived in time (F,)."""
        return np.asarray(np.isfinite(self.arrival_s).all(-1))

    @property
    def min_separation_m(self) -> Array:
        """Smallest true separation of any two vehicles (F,); infinite for one alone."""
        first, second = np.triu_indices(self.trace_enu_m.shape[2], 1)
        gaps = (position[:, first] - position[:, second] for position in self.trace_enu_m)
        least = [separations_m(gap, self.height_share).min(-1, initial=np.inf) for gap in gaps]
        return np.asarray(np.min(least, axis=0))


def fleet_model(fleet: FleetConfig, names: Sequence[str], law: str | None = None) -> FleetModel:
    """Return the named vehicles of a fleet.

    Args:
        fleet: the fleet file.
        names: of vehicles.
        law: "covey", "paper" or "off"; overrides the fleet file's choice.
    Raises:
        ValueError: ``law`` is none of these.
    """
    return FleetModel(
        [pipeline.pipeline_params(fleet, name, law) for name in names],
        [plant_of(fleet.vehicles[name]) for name in names],
        obstacles(fleet),
        fleet.fleet.height_share,
    )


def fly(
    scenario: Scenario,
    model: FleetModel,
    seeds: Sequence[int],
    perturbation: Perturbation | None = None,
) -> RolloutResult:
    """Fly a scenario once per seed, all flights at once.

    Args:
        scenario: leading axis F of one entry per seed.
        model: N vehicles.
        seeds: F seeds.
        perturbation: errors of the flights; by default those of a lab.
    """
    errors = perturbation if perturbation is not None else Perturbation()
    noise = Noise(seeds, scenario.start_enu_m.shape[1])
    start = scenario.start_enu_m.copy()
    start[..., :2] += errors.start_m * noise.starts
    vehicles = VehicleModels(start, model.plants, noise, errors)
    controller = batch.FleetPipeline(model.params, start, model.obstacles)
    sensing = _Sensing(model, start, errors)
    legs = _Legs(scenario)
    parked = legs.is_parked
    radio: _Radio | None = None
    trace: list[Array] = []
    for _ in range(math.ceil(scenario.timeout_s * scenario.legs_enu_m.shape[1] / TICK_S)):
        mocap_noise, gust_noise, link_draws = noise.next()
        states = sensing.update(vehicles, mocap_noise)
        radio = radio or _Radio(states, parked, errors)
        neighbours, is_present = radio.receive(link_draws)
        ticks = controller.step(states, legs.goals(), neighbours, is_present, TICK_S)
        radio.publish(states, ticks)
        sensing.sent(ticks)
        vehicles.advance(ticks["attitude"], gust_noise, errors, TICK_S)
        vehicles.position[:, parked], vehicles.velocity[:, parked] = start[:, parked], 0.0
        trace.append(vehicles.position.copy())
        if not legs.advance(vehicles.position):
            break
    return RolloutResult(legs.arrival_s, np.array(trace), model.height_share)


class _Sensing:
    """Mocap samples, late and noisy, through the drone's own filter."""

    def __init__(self, model: FleetModel, start_enu_m: Array, errors: Perturbation) -> None:
        own = [
            kalman.KalmanParams(errors.mocap_noise_m, drag_1_s=params.drag_1_s)
            for params in model.params
        ]
        self._filters, self._errors = batch.FleetEstimator(own, start_enu_m), errors
        depth = errors.mocap_delay_ticks + 1
        self._samples = deque([start_enu_m] * depth, depth)
        hover = [params.hover_thrust.configured_frac for params in model.params]
        self._throttle = self._hover = np.broadcast_to(hover, start_enu_m.shape[:2])

    def update(self, vehicles: VehicleModels, mocap_noise: Array) -> Rows:
        """Return the states (F, N) of this tick."""
        self._samples.appendleft(vehicles.position + self._errors.mocap_noise_m * mocap_noise)
        return self._filters.step(
            *(vehicles.quaternion_wxyz, self._throttle, self._hover, self._samples[-1]),
            *(np.zeros(self._hover.shape), self._errors.mocap_delay_ticks * TICK_S, TICK_S),
        )

    def sent(self, ticks: Rows) -> None:
        """Take the throttle that was sent last and the hover thrust estimated with it."""
        self._throttle, self._hover = ticks["attitude"]["thrust_frac"], ticks["hover_thrust_frac"]


class _Radio:
    """The newest message of every vehicle at every other one, late and with losses."""

    def __init__(self, states: Rows, is_parked: BoolArray, errors: Perturbation) -> None:
        first = batch.message(states, None)
        flights, count = first.shape
        self._errors, self._delay_s = errors, errors.message_delay_ticks * TICK_S
        self._sent = deque(
            [first] * (errors.message_delay_ticks + 1), errors.message_delay_ticks + 1
        )
        self._inbox = np.repeat(first[:, None], count, axis=1)  # (F, receiver, sender)
        self._age_s = np.full((flights, count, count), self._delay_s)
        self._others = batch.all_others(count)
        self._is_cooperative = np.broadcast_to(~is_parked, self._age_s.shape)
        self._is_present = np.ones((flights, *self._others.shape), bool)

    def receive(self, link_draws: Array) -> tuple[Rows, BoolArray]:
        """Return the neighbours (F, N, K) of this tick, and that all of them are known."""
        is_received = link_draws >= self._errors.message_loss
        np.copyto(
            floats(self._inbox), floats(self._sent[-1])[:, None], where=is_received[..., None]
        )
        self._age_s = np.where(is_received, self._delay_s, self._age_s + TICK_S)
        return batch.received(
            self._inbox, self._age_s, self._others, self._is_cooperative
        ), self._is_present

    def publish(self, states: Rows, ticks: Rows) -> None:
        """Take the messages of this tick."""
        self._sent.appendleft(batch.message(states, ticks))


class _Legs:
    """Progress of the flights along their legs."""

    def __init__(self, scenario: Scenario) -> None:
        flights, self.count, vehicles = scenario.legs_enu_m.shape[:3]
        self._scenario, self._flights = scenario, np.arange(flights)
        self.is_parked = np.array(scenario.is_parked or [False] * vehicles)
        self.is_open = np.ones(flights, bool)
        self.arrival_s = np.full((flights, self.count), np.inf)
        self._leg = np.zeros(flights, np.int64)
        self._time_s, self._near_s = np.zeros(flights), np.zeros((flights, vehicles))

    def goals(self) -> Rows:
        """Return the goals (F, N) of this tick."""
        leg = np.minimum(self._leg, self.count - 1)
        goals = batch.GOAL.rows(self._near_s.shape)
        goals["position_enu_m"] = self._scenario.legs_enu_m[self._flights, leg]
        goals["duration_s"], goals["sequence"] = (
            self._scenario.duration_s[leg][:, None],
            self._leg[:, None],
        )
        return goals

    def advance(self, position_enu_m: Array) -> bool:
        """Take the positions after a tick; returns whether any flight goes on."""
        scenario = self._scenario
        goal = scenario.legs_enu_m[self._flights, np.minimum(self._leg, self.count - 1)]
        away = np.sqrt(((position_enu_m - goal) ** 2).sum(-1))
        self._near_s = np.where(away < scenario.arrival_m, self._near_s + TICK_S, 0.0)
        self._time_s = self._time_s + TICK_S
        has_arrived = np.asarray((self._near_s >= scenario.settle_s)[:, ~self.is_parked].all(-1))
        done = np.flatnonzero(self.is_open & (has_arrived | (self._time_s >= scenario.timeout_s)))
        leg = self._leg[done]
        self.arrival_s[done, leg] = np.where(
            has_arrived[done], self._time_s[done] - scenario.settle_s, np.inf
        )
        self._leg[done] += 1
        self._time_s[done] = 0.0
        self._near_s[done] = 0.0
        self.is_open = self.is_open & (self._leg < self.count)
        return bool(self.is_open.any())
