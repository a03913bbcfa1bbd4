"""Contestants: Covey's law, the same without one of its ideas, the paper's ring, or a peer in the
law's place.

The pipeline around the law, from the estimate to the attitude, is the product's own for all of
them, and a peer comes into it as any law of somebody's own does (docs/own-law.md).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from onboard.arrays import Array, BoolArray, IntArray
from onboard.avoidance.params import Capsule
from onboard.config.fleet import ConfigError, OwnLaw
from onboard.control.pipeline import PipelineParams
from onboard.rollout import batch
from onboard.rollout.own_law_fleet import OwnLawFleet
from onboard.rollout.rows import Rows
from sitl.monte_carlo import campaign_settings
from tests.bench.peers import stage
from tests.bench.peers.encounter import Step
from tests.bench.peers.methods import METHODS, Method


def same(values: Any) -> Any:
    """Nothing changed."""
    return values


@dataclass(frozen=True, slots=True)
class Contestant:
    """A law, or a peer in its place."""

    title: str
    built_in: str = "covey"  # the product's law whose parameters are taken
    sets: tuple[str, ...] = ()  # values of the fleet file, as ``covey simulate --set`` takes them
    change: Callable[[PipelineParams], PipelineParams] = same  # of the parameters after that
    step: Step | None = None  # a peer in the law's place
    own: stage.Law | None = None  # or any law of somebody's own
    values: Mapping[str, float] = field(default_factory=dict)  # of the peer
    hear: Callable[[Rows], Rows] = same  # of the neighbours' messages

    def controller(
        self,
        params: Sequence[PipelineParams],
        start_enu_m: Array,
        obstacles: Sequence[Capsule],
        is_flown: BoolArray,
    ) -> batch.Controller:
        """Return the control of a batch with this contestant in the law's place, compiled where
        that is possible.
        """
        if not self.is_compiled:
            return self.interpreted(self.law(), params, start_enu_m, obstacles, is_flown)
        changed = [self.change(own) for own in params]
        return Hearing(batch.FleetPipeline(changed, start_enu_m, obstacles), self.hear)

    @property
    def is_compiled(self) -> bool:
        """Whether it is a law of Covey's, with some change or none."""
        return self.step is None and self.own is None

    def law(self) -> stage.Timed:
        """Return the law of this contestant as anybody's own, with a stop-watch."""
        own = self.own or (
            stage.covey if self.step is None else stage.law_of(self.step, self.values)
        )
        return stage.Timed(own)

    def interpreted(
        self,
        law: stage.Timed,
        params: Sequence[PipelineParams],
        start_enu_m: Array,
        obstacles: Sequence[Capsule],
        is_flown: BoolArray,
    ) -> Hearing:
        """Return the control of a batch that flies by :meth:`law`, interpreted as any law of
        somebody's own.
        """
        changed = [self.change(own) for own in params]
        own = OwnLaw(self.title, "", "", lambda: law)
        control = OwnLawFleet(
            law=own,
            params=changed,
            start_enu_m=start_enu_m,
            obstacles=obstacles,
            is_flown=is_flown,
        )
        return Hearing(control, self.hear)


class Hearing:
    """A control whose vehicles hear other messages."""

    def __init__(
        self, control: batch.FleetPipeline | OwnLawFleet, hear: Callable[[Rows], Rows]
    ) -> None:
        self._control = control
        self._hear = hear

    @property
    def refusals(self) -> dict[int, str]:
        """Flights that Covey's law went on with."""
        return self._control.refusals if isinstance(self._control, OwnLawFleet) else {}

    def step(
        self, states: Rows, goals: Rows, neighbours: Rows, is_present: BoolArray, dt_s: float
    ) -> Rows:
        """Return the ticks of all vehicles."""
        return self._control.step(states, goals, self._hear(neighbours), is_present, dt_s)

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._control.keep(flights)


def peer(method: Method, values: Mapping[str, float] | None = None) -> Contestant:
    """A method of other people with its chosen values, or others to be tried.

    Where it is refused the flight does not count, so that no law of Covey's needs to be computed
    beside it.
    """
    chosen = method.chosen if values is None else values
    return Contestant(method.title, built_in="off", step=method.step, values=chosen)


def combinations(grid: Mapping[str, Sequence[float]]) -> list[dict[str, float]]:
    """Every combination of a grid."""
    return [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]


RING_GRID = {"kappa": (1.0, 2.0, 4.0), "v_perp_m_s": (0.1, 0.4)}
RING_CHOSEN = {"kappa": 2.0, "v_perp_m_s": 0.1}


def ring(values: Mapping[str, float] = RING_CHOSEN) -> Contestant:
    """The paper's law as printed: each avoids the next one. ``kappa`` is kappa_1 and kappa_2."""
    kappa = values["kappa"]
    v_perp = values["v_perp_m_s"]
    changed = {
        "force_ring": "true",
        "kappa_1_1_s": kappa,
        "kappa_2_1_s": kappa,
        "v_perp_m_s": v_perp,
    }

    # d_inf is the design distance, as for everybody
    def with_margin(params: PipelineParams) -> PipelineParams:
        spacing = params.law.spacing
        d_design_m = spacing.safety_distance_m + spacing.margin_m
        return params._replace(
            law=params.law._replace(paper=params.law.paper._replace(d_inf_m=d_design_m))
        )

    sets = tuple(f"law.paper_{key}={value}" for key, value in changed.items())
    return Contestant(
        "the paper's ring", built_in="paper", sets=sets, change=with_margin, values=values
    )


COVEY = Contestant("Covey")
OFF = Contestant("no avoidance", built_in="off")
PEERS = {"covey": COVEY, "off": OFF, "ring": ring()} | {
    name: peer(method) for name, method in METHODS.items()
}


def named(name: str) -> Contestant:
    """Return a contestant by its key above, or a law of somebody's own by the name that a fleet
    file gives it.

    Raises:
        ConfigError: there is no such law.
    """
    if name in PEERS:
        return PEERS[name]
    law = campaign_settings.setup_for(law=name).fleet(1).own_law
    if law is None:
        raise ConfigError(
            f"--law is '{name}'; name a law of your own as module:function (docs/own-law.md)."
        )
    return Contestant(name, own=law.load())
