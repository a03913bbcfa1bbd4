"""A mission's view of the fleet: ``await fleet.takeoff()``, ``await fleet["mav1"].reached(...)``."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.missions.verdict import Arrival, StepResult, is_landed, smallest
from groundstation.orders.grammar import DEFAULT_HEIGHT_M, Intent, OrderError
from groundstation.orders.result import VehicleResult
from onboard.bus.schema import Vec3
from onboard.config.fleet import ConfigError, FleetConfig

READY_STATES = ("ready", "landed", "armed", "flying", "holding")
ARRIVED_M = 0.15
LAND_AGAIN_S = 6.0
TOLD_WITHIN_S = 0.3
Results = dict[str, VehicleResult]
Who = str | Sequence[str]


class OrderFailed(RuntimeError):
    """At least one vehicle did not do what was ordered; ``results`` says which and why."""

    def __init__(self, intent: Intent, results: Results) -> None:
        self.results = results
        reasons = [
            f"{result.vehicle} {result.phase}: {result.sentence}" for result in results.values() if not result.is_done
        ]
        super().__init__(f"'{intent}' failed. {' '.join(reasons)}")


class NotReady(RuntimeError):
    """The fleet did not get ready in time; ``heard`` tells whether anybody answered at all."""

    def __init__(self, sentence: str, heard: bool) -> None:
        self.heard = heard
        super().__init__(sentence)


class Fleet:
    """All vehicles of a fleet, for missions.

    Args:
        client: started.
        say: progress in words, one line a call.
    """

    def __init__(self, client: FleetClient, *, say: Callable[[str], None] = lambda line: None) -> None:
        self.client = client
        self.say = say
        self.steps: list[StepResult] = []
        self.arrivals: list[Arrival] = []

    @property
    def config(self) -> FleetConfig:
        """The fleet file."""
        return self.client.fleet

    @property
    def names(self) -> tuple[str, ...]:
        """Vehicles that take part."""
        return self.config.enabled_names

    @property
    def state(self) -> FleetState:
        """What is known now."""
        return self.client.state

    def __getitem__(self, name: str) -> VehicleHandle:
        if name not in self.names:
            raise ConfigError(
                f"'{name}' is not a vehicle of fleet '{self.config.fleet.name}': {', '.join(self.names)}."
            )
        return VehicleHandle(self, name)

    async def ready(self, timeout_s: float = 60.0) -> None:
        """Wait until every vehicle reports that it may fly. NotReady otherwise."""

        def is_ready(state: FleetState) -> bool:
            return all(_is_ready(state, name, self.client.now_ns()) for name in self.names)

        if await self.client.wait_for(is_ready, timeout_s):
            refusal = self.client.control.refusal("takeoff")
            if refusal is not None:
                raise NotReady(refusal, True)
            return
        now_ns = self.client.now_ns()
        reasons, heard = [], False
        for name in self.names:
            view = self.state.vehicles[name]
            if view.telemetry is None or not view.is_fresh(now_ns):
                reasons.append(f"{name} does not answer.")
                continue
            heard = True
            if not _is_ready(self.state, name, now_ns):
                why = " ".join(view.telemetry.not_ready) or view.telemetry.reason or "it does not say why."
                reasons.append(f"{name} is {view.telemetry.state}: {why.rstrip('.')}.")
        raise NotReady(f"Not ready within {timeout_s:g} s. {' '.join(reasons)}", heard)

    async def arm(self, vehicles: Who = "all", *, timeout_s: float = 15.0) -> Results:
        """Arm on the ground."""
        return await self.order(Intent("arm", self._select(vehicles)), timeout_s)

    async def locate(self, vehicles: Who, *, timeout_s: float = 5.0) -> Results:
        """Let vehicles play a tune, so that an operator sees which ones they are."""
        return await self.order(Intent("locate", self._select(vehicles)), timeout_s)

    identify = locate  # the former name, which missions may still use

    async def takeoff(
        self, height_m: float = DEFAULT_HEIGHT_M, vehicles: Who = "all", *, timeout_s: float = 40.0
    ) -> Results:
        """Climb to a height above the fleet's origin."""
        return await self.order(Intent("takeoff", self._select(vehicles), height_m=height_m), timeout_s)

    async def move(
        self, position_enu_m: Vec3, vehicles: Who = "all", *, duration_s: float = 0.0, timeout_s: float = 40.0
    ) -> Results:
        """One vehicle: its own goal. Several: the position of the formation that holds."""
        names = self._select(vehicles)
        return await self.order(Intent("move", names, position_enu_m=position_enu_m, duration_s=duration_s), timeout_s)

    async def formation(
        self,
        name: str,
        position_enu_m: Vec3,
        vehicles: Who = "all",
        *,
        duration_s: float = 0.0,
        timeout_s: float = 40.0,
    ) -> Results:
        """Take up a formation at a position."""
        if name not in self.config.formations:
            known = ", ".join(self.config.formations) or "none"
            raise ConfigError(f"'{name}' is no formation of this fleet; it has {known}.")
        names = self._select(vehicles)
        if vehicles == "all":
            names = tuple(vehicle for vehicle in names if vehicle in self.config.formations[name])
        intent = Intent("formation", names, position_enu_m=position_enu_m, formation=name, duration_s=duration_s)
        return await self.order(intent, timeout_s)

    async def hold(self, vehicles: Who = "all", *, timeout_s: float = 15.0) -> Results:
        """Stop at the present spot."""
        return await self.order(Intent("hold", self._select(vehicles)), timeout_s)

    async def land(self, vehicles: Who = "all", *, timeout_s: float = 40.0) -> Results:
        """Land and disarm."""
        return await self.order(Intent("land", self._select(vehicles)), timeout_s)

    async def disarm(self, vehicles: Who = "all", *, timeout_s: float = 15.0) -> Results:
        """Disarm on the ground."""
        return await self.order(Intent("disarm", self._select(vehicles)), timeout_s)

    async def wait(self, duration_s: float) -> None:
        """Let time pass."""
        await asyncio.sleep(duration_s)

    async def fault(
        self,
        name: str,
        vehicles: Who,
        *,
        after_s: float = 0.0,
        duration_s: float = 0.0,
        is_rehearsal: bool = False,
        **parameters: float | str,
    ) -> None:
        """Let something go wrong in the emulator, `after_s` of simulated time from now; 0 for ever.

        Raises:
            FaultRefused: impossible, or this flight is not simulated.
        """
        for vehicle in self._select(vehicles):
            sentence = await self.client.fault(
                name, vehicle, parameters, after_s=after_s, duration_s=duration_s, is_rehearsal=is_rehearsal
            )
            if not is_rehearsal:
                when = f" in {after_s:g} s" if after_s > 0.0 else ""
                self.say(f"fault{when}: {sentence}")

    async def order(self, intent: Intent, timeout_s: float) -> Results:
        """Give an order, wait for its end, note the results. OrderFailed unless every vehicle did it."""
        self.say(f"{intent}")
        begin_ns = self.client.now_ns()
        try:
            handle = await self.client.submit(intent)
        except OrderError as error:
            raise ConfigError(str(error)) from None
        results = await handle.wait(timeout_s)
        for name, order in handle.planned.orders.items():
            if order.position_enu_m is not None:
                self.arrivals.append(self._arrival(str(intent.verb), name, order.position_enu_m))
        self.steps.append(
            StepResult(
                step=str(intent),
                duration_s=round((self.client.now_ns() - begin_ns) * 1e-9, 2),
                vehicles={name: result.phase for name, result in results.items()},
                sentences={name: result.sentence for name, result in results.items()},
            )
        )
        if all(result.is_done for result in results.values()):
            self.say(f"  done in {self.steps[-1].duration_s:.1f} s{self._closest_words()}")
        for name, result in results.items():
            if not result.is_done:
                self.say(f"  {name} {result.phase}: {result.sentence}")
        if not all(result.is_done for result in results.values()):
            raise OrderFailed(intent, results)
        return results

    async def land_all(self, timeout_s: float = 40.0) -> bool:
        """Land whoever is not down yet, whatever happened; True when all are landed and disarmed.

        Who is landing already goes on with that: an operator's order is not replaced by one that asks the same.
        """
        up = tuple(name for name in self.names if _may_fly(self.state, name))
        end_ns = self.client.now_ns() + int(timeout_s * 1e9)
        taken = [
            name for name, phase in (self.steps[-1].vehicles if self.steps else {}).items() if phase == "superseded"
        ]
        if taken:  # somebody else has ordered something: the next telemetry tells whether it was to land
            await self.client.wait_for(lambda _: all(map(self._is_landing, taken)), TOLD_WITHIN_S)
        left = up
        while left and self.client.now_ns() < end_ns:
            asked = tuple(name for name in left if not self._is_landing(name))
            if not asked:
                if await self.client.wait_for(_all_landed(up), LAND_AGAIN_S):
                    return True
                left = tuple(name for name in left if not is_landed(self.state, name))
                continue
            self.say(f"Landing {', '.join(asked)}.")
            handle = await self.client.submit(Intent("land", asked))
            await handle.wait((end_ns - self.client.now_ns()) * 1e-9)
            # An order can end before the vehicle is down: when a failsafe has taken over, PX4 lands by itself.
            # Whom PX4 itself reports disarmed, on the second way, has no agent left to tell it.
            down = {name for name, result in handle.results.items() if result.is_done}
            left = tuple(name for name in left if name not in down)
            if await self.client.wait_for(_all_landed(up), LAND_AGAIN_S if left else 1.0):
                return True
            for name, result in handle.results.items():
                if not result.is_done:
                    self.say(f"  {name} {result.phase}: {result.sentence}")
            left = tuple(name for name in left if not is_landed(self.state, name))
        return not left

    def _is_landing(self, name: str) -> bool:
        view = self.state.vehicles[name]
        told = view.telemetry
        return told is not None and view.is_fresh(self.client.now_ns()) and told.state == "landing"

    def _closest_words(self) -> str:
        near = smallest(self.state)
        return (
            "" if near is None else f"; smallest distance so far {near.distance_m:.2f} m ({near.first}, {near.second})"
        )

    def _select(self, vehicles: Who) -> tuple[str, ...]:
        return self.config.select(vehicles if isinstance(vehicles, str) else ",".join(vehicles))

    def _arrival(self, step: str, name: str, goal: Vec3) -> Arrival:
        view = self.state.vehicles[name]
        now_ns = self.client.now_ns()
        if view.truth is not None and view.has_truth(now_ns):
            return Arrival(step, name, round(math.dist(view.truth.position_enu_m, goal), 4), True)
        spot = view.position_enu_m(now_ns)
        return Arrival(step, name, math.inf if spot is None else round(math.dist(spot, goal), 4), False)


class VehicleHandle:
    """One vehicle of a fleet."""

    def __init__(self, fleet: Fleet, name: str) -> None:
        self._fleet = fleet
        self.name = name

    @property
    def position_enu_m(self) -> Vec3 | None:
        """Where it reports to be; None when it does not, now."""
        return self._fleet.state.vehicles[self.name].position_enu_m(self._fleet.client.now_ns())

    async def reached(self, position_enu_m: Vec3, within_m: float = ARRIVED_M, timeout_s: float = 40.0) -> bool:
        """Wait until it reports a position within ``within_m``; False when it did not in time."""

        def is_there(state: FleetState) -> bool:
            spot = state.vehicles[self.name].position_enu_m(self._fleet.client.now_ns())
            return spot is not None and math.dist(spot, position_enu_m) <= within_m

        return await self._fleet.client.wait_for(is_there, timeout_s)

    async def takeoff(self, height_m: float = DEFAULT_HEIGHT_M, *, timeout_s: float = 40.0) -> VehicleResult:
        """Climb to a height above the fleet's origin."""
        return (await self._fleet.takeoff(height_m, self.name, timeout_s=timeout_s))[self.name]

    async def move(self, position_enu_m: Vec3, *, duration_s: float = 0.0, timeout_s: float = 40.0) -> VehicleResult:
        """Fly to a point."""
        results = await self._fleet.move(position_enu_m, self.name, duration_s=duration_s, timeout_s=timeout_s)
        return results[self.name]

    async def hold(self, *, timeout_s: float = 15.0) -> VehicleResult:
        """Stop at the present spot."""
        return (await self._fleet.hold(self.name, timeout_s=timeout_s))[self.name]

    async def land(self, *, timeout_s: float = 40.0) -> VehicleResult:
        """Land and disarm."""
        return (await self._fleet.land(self.name, timeout_s=timeout_s))[self.name]


def _all_landed(names: Sequence[str]) -> Callable[[FleetState], bool]:
    return lambda state: all(is_landed(state, name) for name in names)


def _may_fly(state: FleetState, name: str) -> bool:
    """Whether it flies or is about to: an order to take off precedes the telemetry that shows it."""
    telemetry = state.vehicles[name].telemetry
    if telemetry is None:
        return False
    return not is_landed(state, name) or telemetry.state in ("armed", "taking off", "flying", "holding", "landing")


def _is_ready(state: FleetState, name: str, now_ns: int) -> bool:
    view = state.vehicles[name]
    telemetry = view.telemetry
    return (
        telemetry is not None and view.is_fresh(now_ns) and telemetry.state in READY_STATES and not telemetry.not_ready
    )
