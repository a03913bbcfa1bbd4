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
from typing import NamedTuple

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
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

# makes the control of a batch from the parameters (N,) and starts (F, N, 3) of the vehicles, the
# obstacles, and whether the law flies each vehicle (F, N)
MakeController = Callable[
    [Sequence[pipeline.PipelineParams], Array, Sequence[Capsule], BoolArray], batch.Controller
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


class _Sensed(NamedTuple):
    """States of all vehicles in a tick; the two offsets are None if nobody lies."""

    believed: Rows  # by which the vehicles fly
    published: Rows
    offset_m: Array | None = None  # of the positions that liars publish
    velocity_m_s: Array | None = None  # rate of change of the offset


@dataclass(frozen=True, slots=True)
class Flown:
    """A plan and the outcome of its flight."""

    plan: FlightPlan
    outcome: FlightOutcome
    # time that the slowest vehicle needs without avoidance; inf if it does not arrive
    straight_line_s: float
    # a user's own law, and why Covey's law took over from it; empty: it did not
    law_refusal: str = ""


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

    outcomes, refusals = _FlightBatch(
        plans,
        setup,
        longest_s,
        controller=controller,
        physics=physics,
        has_trace=has_trace,
    ).fly()

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
        outcomes, _ = _FlightBatch(missing, alone, limits_s, physics=physics, is_alone=True).fly()
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


class _FlightBatch:
    """Flights under way together, with all that senses, controls, moves and judges them.

    Args:
        plans: the plans, all of the same number of vehicles.
        setup: fleet, law, errors and perturbation of all flights.
        longest_s: time of each flight after which it is ended.
        controller: makes the control of all vehicles; by default from the law of the fleet.
        physics: name of the physics.
        is_alone: whether vehicles get no messages, know no obstacles and do not lie.
        has_trace: whether the outcomes hold samples of the flight.
    """

    def __init__(
        self,
        plans: Sequence[FlightPlan],
        setup: Setup,
        longest_s: Sequence[float],
        *,
        controller: MakeController | None = None,
        physics: str = worlds.DEFAULT,
        is_alone: bool = False,
        has_trace: bool = False,
    ) -> None:
        count = plans[0].count
        fleet = setup.fleet(count)
        vehicles = list(fleet.vehicles.values())
        start_enu_m = np.stack([plan.start_enu_m for plan in plans])  # (F, N, 3)
        scripted_m_s = _scripted_m_s(plans)
        is_scripted = np.isfinite(scripted_m_s[..., 0])

        self._noise = FlightNoise([plan.seed for plan in plans], count, has_links=not is_alone)
        self._world = worlds.world_of(physics)(
            vehicles=vehicles,
            start_enu_m=start_enu_m,
            scripted=scripted_m_s,
            noise=self._noise,
            perturbation=setup.perturbation,
            seeds=[plan.seed for plan in plans],
            wash_diameter_m=_wash_diameter_m(fleet),
        )
        self._truth = self._world.truth()
        self._sensors = sensing(setup.errors, vehicles, self._truth, self._noise)

        obstacles = () if is_alone else plans[0].obstacles
        make_controller = _controller(fleet) if controller is None else controller
        other_law = None if is_alone else plans[0].other_law
        is_of_other = _is_of_other(other_law, count)
        self._pipelines = make_controller(
            params_of(fleet), start_enu_m, obstacles, ~(is_scripted | is_of_other)
        )
        if other_law is not None:
            other_fleet = replace(setup, law=other_law.name).fleet(count)
            by_other_law = _controller(other_fleet)(
                params_of(other_fleet), start_enu_m, obstacles, ~is_scripted & is_of_other
            )
            self._pipelines = MixedFleet(self._pipelines, by_other_law, is_of_other)

        self._metrics = FlightMetrics(
            plans=plans,
            longest_s=longest_s,
            fleet=fleet,
            errors=setup.errors,
            gusts_m_s2=[setup.perturbation.gusts_m_s2(vehicle.drag_1_s) for vehicle in vehicles],
            start_enu_m=start_enu_m,
            has_trace=has_trace,
        )
        self._orders = FlightOrders(plans)
        self._lies = MemberLies(plans)
        self._has_lies = self._lies.has_any and not is_alone

        # the radio begins with the states that the vehicles sense in the first tick
        self._radio: Radio | None = None
        self._make_radio: Callable[[Rows], Radio] | None = None
        if not is_alone:
            self._make_radio = partial(
                Radio,
                is_intruder=is_scripted,
                perturbation=setup.perturbation,
                lateness_s=fleet.expected_radio.lateness_s,
                radius_m=person_radii_m(plans),
            )

        # both (F, N): the thrust sent last, and the hover thrust that the pipelines estimate
        nominal_hover = [vehicle.hover_thrust_frac for vehicle in vehicles]
        self._throttle = np.broadcast_to(nominal_hover, start_enu_m.shape[:2])
        self._hover = self._throttle

    def fly(self) -> tuple[list[FlightOutcome], dict[int, str]]:
        """Fly all to their ends.

        Returns:
            The outcomes, and by index of the flight the reason why a user's own law was refused.
        """
        while True:
            going_on = self._tick()
            if len(going_on) == 0:
                # only the control by a user's own law has refusals
                return self._metrics.outcomes, getattr(self._pipelines, "refusals", {})
            if len(going_on) < len(self._throttle):
                self._keep(going_on)

    def _tick(self) -> IntArray:
        """Fly one tick of all flights, and return the rows of those that go on."""
        normals, link_draws = self._noise.next()
        sensed = self._sense(normals)

        if self._radio is None and self._make_radio is not None:
            self._radio = self._make_radio(sensed.believed)

        ticks = self._control(sensed, link_draws)
        if self._radio is not None:
            self._radio.publish(sensed.published, self._published_ticks(sensed, ticks))

        self._throttle = ticks["attitude"]["thrust_frac"]
        self._hover = ticks["hover_thrust_frac"]
        self._world.advance(ticks["attitude"]["quaternion_wxyz"], self._throttle, normals)
        self._truth = self._world.truth()

        going_on = self._metrics.update(self._truth, ticks, self._most_avoided(ticks))
        self._orders.advance(self._metrics)
        return going_on

    def _sense(self, normals: Array) -> _Sensed:
        """Return the states that the vehicles measure; liars change what they publish.

        A liar that believes its false position also flies by it.
        """
        states = self._sensors.update(self._truth, normals, self._throttle, self._hover)
        if not self._has_lies:
            return _Sensed(believed=states, published=states)

        offset_m, velocity_m_s = self._lies.offsets(self._metrics.time_s)
        published = shifted(states, offset_m, velocity_m_s, _OF_STATE)
        is_believed = self._lies.is_believed()[:, None]
        return _Sensed(
            believed=np.where(is_believed, published, states),
            published=published,
            offset_m=offset_m,
            velocity_m_s=velocity_m_s,
        )

    def _control(self, sensed: _Sensed, link_draws: Array) -> Rows:
        """Return the ticks of all pipelines, which know the messages of earlier ticks.

        The autopilot of a frozen vehicle holds its position without avoiding.
        """
        is_frozen, is_mute = self._orders.lost(self._metrics.time_s)
        neighbours = layouts.NEIGHBOUR.rows((*is_frozen.shape, 0))
        if self._radio is not None:
            tracked = self._sensors.tracked()
            neighbours = self._radio.receive(link_draws, is_mute, is_frozen, tracked)

        has_neighbours = ~(is_frozen | self._orders.is_blind)
        return self._pipelines.step(
            sensed.believed,
            self._orders.goals(is_frozen, self._truth),
            neighbours,
            np.broadcast_to(has_neighbours[..., None], neighbours.shape),
            TICK_S,
        )

    def _published_ticks(self, sensed: _Sensed, ticks: Rows) -> Rows:
        """Return the ticks as published; a liar's prediction is as false as its position.

        A vehicle that believes its false position already predicts from it, so its prediction
        needs no change.
        """
        if sensed.offset_m is None or sensed.velocity_m_s is None:
            return ticks
        is_false = sensed.offset_m.any(-1) & ~self._lies.is_believed()[:, None]
        if not is_false.any():
            return ticks

        false_ticks = ticks.copy()
        false_ticks["law"] = shifted(ticks["law"], sensed.offset_m, sensed.velocity_m_s, _OF_LAW)
        return np.where(is_false, false_ticks, ticks)

    def _most_avoided(self, ticks: Rows) -> IntArray:
        """Return the index (F, N) in the fleet of the neighbour that each vehicle avoids most.

        The law gives its index among the received neighbours.
        """
        most_avoided = ticks["law"]["active_neighbour"].astype(np.int64)
        if self._radio is None:
            return most_avoided
        return self._radio.vehicle(most_avoided)

    def _keep(self, going_on: IntArray) -> None:
        """Remove the rows of the flights that have ended from all arrays."""
        self._throttle = self._throttle[going_on]
        self._hover = self._hover[going_on]
        for part in (
            self._noise,
            self._sensors,
            self._pipelines,
            self._world,
            self._metrics,
            self._orders,
            self._lies,
        ):
            part.keep(going_on)
        if self._radio is not None:
            self._radio.keep(going_on)
        self._truth = self._world.truth()


def _scripted_m_s(plans: Sequence[FlightPlan]) -> Array:
    """Return the velocities (F, N, 3) of intruders [m/s]; NaN for multirotors."""
    velocities_m_s = np.full((len(plans), plans[0].count, 3), np.nan)
    for flight, plan in enumerate(plans):
        if plan.intruder_m_s is not None:
            velocities_m_s[flight, -1] = plan.intruder_m_s
    return velocities_m_s


def _wash_diameter_m(fleet: FleetConfig) -> float:
    """Return the diameter of the rotors' wash [m]; 0 where vehicles may not fly above others."""
    if fleet.fleet.vertical_separation_m is None:
        return 0.0
    return fleet.fleet.body_diameter_m


def _is_of_other(other: OtherLaw | None, count: int) -> BoolArray:
    """Return whether each vehicle (N,) uses the second law."""
    if other is None:
        return np.zeros(count, bool)
    return np.isin(np.arange(count), other.vehicles)


def params_of(fleet: FleetConfig) -> list[pipeline.PipelineParams]:
    """Return the parameters of the pipelines of all vehicles of a fleet."""
    return [pipeline.pipeline_params(fleet, name) for name in fleet.vehicles]


def _controller(fleet: FleetConfig) -> MakeController:
    """Return what controls the vehicles of a fleet by its law."""
    if fleet.own_law is None:
        return _built_in
    return partial(OwnLawFleet, fleet.own_law)


def _built_in(
    params: Sequence[pipeline.PipelineParams],
    start_enu_m: Array,
    obstacles: Sequence[Capsule],
    _is_flown: BoolArray,
) -> batch.Controller:
    """Return the control by a built-in law, which is compiled and computes all vehicles."""
    return batch.FleetPipeline(params, start_enu_m, obstacles)
