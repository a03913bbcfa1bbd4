"""Flies the pipeline in a closed loop with vehicle models, for many flights and vehicles at once.

Each vehicle flies with its own estimate from noisy, late mocap samples. It receives the messages of
the other vehicles late and with losses. Each flight draws its random numbers from its own seed, so
it gives the same result alone and in a batch.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance.params import Capsule, still
from onboard.config.fleet import FleetConfig
from onboard.config.pair_separation import separations_m
from onboard.control import pipeline
from onboard.estimation import kalman
from onboard.rollout import batch, layouts
from onboard.rollout.radio import Radio
from onboard.rollout.rows import Rows
from onboard.rollout.vehicle_model import Noise, Perturbation, Plant, VehicleModels, plant_of
from onboard.types import TICK_S


@dataclass(frozen=True, slots=True)
class Scenario:
    """Legs that F flights of N vehicles fly in sequence.

    A leg ends when all vehicles have arrived, or when its time is up.
    """

    start_enu_m: Array  # (F, N, 3) starts
    legs_enu_m: Array  # (F, L, N, 3) goals of each leg
    duration_s: Array  # (L,) commanded duration of each leg
    timeout_s: float = 40.0  # longest time of a leg
    is_parked: tuple[bool, ...] = ()  # (N,) whether a vehicle never moves; empty: all move

    # a vehicle has arrived when it has been within this distance of its goal for this time
    arrival_m: float = 0.15
    settle_s: float = 1.0


@dataclass(frozen=True, slots=True)
class FleetModel:
    """The vehicles of a fleet, in the form that :func:`fly` takes."""

    params: Sequence[pipeline.PipelineParams]  # parameters of the N pipelines
    plants: Sequence[Plant]  # dynamics of the N vehicles
    obstacles: tuple[Capsule, ...] = ()
    height_share: float = 0.0  # metres of separation that one metre of height counts for


@dataclass(frozen=True, slots=True)
class RolloutResult:
    """Outcome of F flights."""

    # (F, L) time from the start of a leg to the last vehicle's arrival; inf: not in time
    arrival_s: Array

    # (T, F, N, 3) true positions after each tick, until the last flight has ended
    trace_enu_m: Array
    ticks: IntArray  # (F,) number of ticks of each flight until its own end
    height_share: float = 0.0  # as in FleetModel

    @property
    def is_success(self) -> BoolArray:
        """Whether all vehicles arrived in time in every leg (F,)."""
        return np.asarray(np.isfinite(self.arrival_s).all(-1))

    @property
    def min_separation_m(self) -> Array:
        """Smallest true separation of any two vehicles (F,); infinite for a single vehicle.

        Positions after a flight's own end do not count.
        """
        first, second = np.triu_indices(self.trace_enu_m.shape[2], 1)

        # computed tick by tick, because the pairs of all ticks would fill the memory
        least_m = []
        for tick, position_enu_m in enumerate(self.trace_enu_m):
            gap_m = position_enu_m[:, first] - position_enu_m[:, second]
            pairs_m = separations_m(gap_m, self.height_share)
            nearest_m = pairs_m.min(-1, initial=np.inf)
            least_m.append(np.where(tick < self.ticks, nearest_m, np.inf))
        return np.asarray(np.min(least_m, axis=0))

    def positions_enu_m(self, flight: int) -> Array:
        """Return the true positions [m] of one flight (T, N, 3), after each tick until its own end.

        Args:
            flight: index of the flight.
        """
        return self.trace_enu_m[: self.ticks[flight], flight]


def fleet_model(fleet: FleetConfig, names: Sequence[str], law: str | None = None) -> FleetModel:
    """Return the model of the named vehicles of a fleet.

    Args:
        fleet: the fleet file.
        names: names of the vehicles.
        law: "covey", "paper" or "off"; None: the fleet file's law.
    Raises:
        ValueError: There is no law of that name.
    """
    return FleetModel(
        params=[pipeline.pipeline_params(fleet, name, law) for name in names],
        plants=[plant_of(fleet.vehicles[name]) for name in names],
        obstacles=still(fleet),
        height_share=fleet.fleet.height_share,
    )


def fly(
    scenario: Scenario,
    model: FleetModel,
    seeds: Sequence[int],
    perturbation: Perturbation | None = None,
) -> RolloutResult:
    """Fly a scenario once per seed, all flights at once.

    Args:
        scenario: scenario whose leading axis F has one entry per seed.
        model: the N vehicles.
        seeds: the F seeds.
        perturbation: errors of the flights; None: those of a lab.
    """
    errors = perturbation
    if errors is None:
        errors = Perturbation()

    noise = Noise(seeds, scenario.start_enu_m.shape[1])
    start_enu_m = scenario.start_enu_m.copy()
    start_enu_m[..., :2] += errors.start_m * noise.starts

    vehicles = VehicleModels(start_enu_m, model.plants, noise, errors)
    sensing = _Sensing(model, start_enu_m, errors)
    controller = batch.FleetPipeline(model.params, start_enu_m, model.obstacles)
    legs = _Legs(scenario)
    parked = legs.is_parked
    radio: Radio | None = None  # None before the first estimates

    trace_enu_m: list[Array] = []
    most_ticks = math.ceil(scenario.timeout_s * scenario.legs_enu_m.shape[1] / TICK_S)
    for _ in range(most_ticks):
        mocap_noise, gust_noise, link_draws = noise.next()

        states = sensing.update(vehicles, mocap_noise)
        if radio is None:
            radio = Radio(states, parked, errors)
        neighbours, is_present = radio.receive(link_draws)

        ticks = controller.step(states, legs.goals(), neighbours, is_present, TICK_S)
        radio.publish(states, ticks)
        sensing.remember_thrust(ticks)

        vehicles.advance(ticks["attitude"], gust_noise, errors, TICK_S)
        vehicles.position[:, parked] = start_enu_m[:, parked]
        vehicles.velocity[:, parked] = 0.0

        trace_enu_m.append(vehicles.position.copy())
        if not legs.advance(vehicles.position):
            break

    return RolloutResult(
        arrival_s=legs.arrival_s,
        trace_enu_m=np.array(trace_enu_m),
        ticks=legs.ticks,
        height_share=model.height_share,
    )


class _Sensing:
    """Estimates of all vehicles: the drone's own filter with late and noisy mocap samples."""

    def __init__(self, model: FleetModel, start_enu_m: Array, errors: Perturbation) -> None:
        filters = []
        for params in model.params:
            filters.append(
                kalman.KalmanParams(
                    position_noise_m=errors.mocap_noise_m,
                    drag_1_s=params.drag_1_s,
                )
            )
        self._filters = batch.FleetEstimator(filters, start_enu_m)
        self._errors = errors

        depth = errors.mocap_delay_ticks + 1
        self._samples = deque([start_enu_m] * depth, depth)  # newest first

        # last throttle sent, and hover throttle (F, N)
        hover_frac = [params.hover_thrust.configured_frac for params in model.params]
        self._hover = np.broadcast_to(hover_frac, start_enu_m.shape[:2])
        self._throttle = self._hover

    def update(self, vehicles: VehicleModels, mocap_noise: Array) -> Rows:
        """Return the states (F, N) of this tick."""
        self._samples.appendleft(vehicles.position + self._errors.mocap_noise_m * mocap_noise)
        return self._filters.step(
            quaternion_wxyz=vehicles.quaternion_wxyz,
            thrust_frac=self._throttle,
            hover_thrust_frac=self._hover,
            sample_enu_m=self._samples[-1],
            yaw_rad=np.zeros(self._hover.shape),
            age_s=self._errors.mocap_delay_ticks * TICK_S,
            dt_s=TICK_S,
        )

    def remember_thrust(self, ticks: Rows) -> None:
        """Remember the throttle and the hover thrust of a tick for the next estimate."""
        self._throttle = ticks["attitude"]["thrust_frac"]
        self._hover = ticks["hover_thrust_frac"]


class _Legs:
    """Progress of the flights along their legs."""

    def __init__(self, scenario: Scenario) -> None:
        flights, legs, vehicles = scenario.legs_enu_m.shape[:3]
        self._scenario = scenario
        self._flights = np.arange(flights)
        self._leg_count = legs
        self.is_parked = np.zeros(vehicles, bool)
        if scenario.is_parked:
            self.is_parked = np.array(scenario.is_parked)
        self.arrival_s = np.full((flights, legs), np.inf)

        # index of each flight's present leg; after the last leg it is the number of legs
        self._leg = np.zeros(flights, np.int64)
        self._time_s = np.zeros(flights)  # time since the present leg began
        self._is_open = np.ones(flights, bool)  # whether a flight has not ended
        self.ticks = np.zeros(flights, np.int64)  # number of ticks of each flight until its own end

        # how long each vehicle has been near its goal (F, N)
        self._near_s = np.zeros((flights, vehicles))

    def goals(self) -> Rows:
        """Return the goals (F, N) of this tick."""
        leg = np.minimum(self._leg, self._leg_count - 1)
        goals = layouts.GOAL.rows(self._near_s.shape)
        goals["position_enu_m"] = self._scenario.legs_enu_m[self._flights, leg]
        goals["duration_s"] = self._scenario.duration_s[leg][:, None]
        goals["sequence"] = self._leg[:, None]
        return goals

    def advance(self, position_enu_m: Array) -> bool:
        """Update the legs with the positions after a tick, and return whether any flight
        continues.
        """
        scenario = self._scenario
        self.ticks[self._is_open] += 1
        leg = np.minimum(self._leg, self._leg_count - 1)
        goal_enu_m = scenario.legs_enu_m[self._flights, leg]
        distance_m = np.sqrt(((position_enu_m - goal_enu_m) ** 2).sum(-1))

        self._near_s = np.where(distance_m < scenario.arrival_m, self._near_s + TICK_S, 0.0)
        self._time_s = self._time_s + TICK_S

        has_settled = self._near_s >= scenario.settle_s
        has_arrived = np.asarray(has_settled[:, ~self.is_parked].all(-1))
        is_late = self._time_s >= scenario.timeout_s

        # Record the arrival for the flights whose leg ends at this tick. A vehicle has arrived when
        # it starts to settle. If all vehicles are parked, the leg ends at once.
        ended = np.flatnonzero(self._is_open & (has_arrived | is_late))
        settling_began_s = self._time_s[ended] - scenario.settle_s
        if self.is_parked.all():
            settling_began_s = np.zeros(len(ended))
        arrival_s = np.where(has_arrived[ended], settling_began_s, np.inf)
        self.arrival_s[ended, self._leg[ended]] = arrival_s

        self._leg[ended] += 1
        self._time_s[ended] = 0.0
        self._near_s[ended] = 0.0
        self._is_open = self._is_open & (self._leg < self._leg_count)
        return bool(self._is_open.any())
