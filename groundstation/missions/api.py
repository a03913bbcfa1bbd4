"""A mission's view of the fleet: ``await fleet.takeoff()``, ``await fleet["mav1"].reached(...)``."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from groundstation.missions.landing import land_all
from groundstation.missions.path_following import Lights, Paths, follow_paths
from groundstation.missions.readiness import NotReady as NotReady  # missions import it from here
from groundstation.missions.readiness import is_ready, not_ready
from groundstation.missions.verdict import Arrival, StepResult, arrival_of, smallest
from groundstation.orders.grammar import DEFAULT_HEIGHT_M, Intent
from groundstation.orders.path_orders import OnLag
from groundstation.orders.result import OrderFailed as OrderFailed
from groundstation.orders.result import Results, VehicleResult
from onboard.bus.schema import Vec3
from onboard.config.fleet import ConfigError, FleetConfig

ARRIVED_M = 0.15
Vehicles = str | Sequence[str]  # "all", names or indices: "mav0,mav2", "0-1", or a list of names


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
        """The fleet as known now."""
        return self.client.state

    def __getitem__(self, name: str) -> MissionVehicle:
        if name not in self.names:
            raise ConfigError(
                f"'{name}' is not a vehicle of fleet '{self.config.fleet.name}': {', '.join(self.names)}."
            )
        return MissionVehicle(self, name)

    async def ready(self, timeout_s: float = 60.0) -> None:
        """Wait until every vehicle reports that it may fly.

        Args:
            timeout_s: longest wait [s].

        Raises:
            NotReady: a vehicle is not ready in time, or another ground operates the fleet.
        """

        def are_ready(state: FleetState) -> bool:
            return all(is_ready(state, name, self.client.now_ns()) for name in self.names)

        if not await self.client.wait_for(are_ready, timeout_s):
            raise not_ready(self.state, self.names, self.client.now_ns(), timeout_s)
        refusal = self.client.control.refusal("takeoff")
        if refusal is not None:
            raise NotReady(refusal, True)

    async def arm(self, vehicles: Vehicles = "all", *, timeout_s: float = 15.0) -> Results:
        """Arm on the ground.

        Args:
            vehicles: to order.
            timeout_s: longest wait for the end of the order [s].

        Returns:
            One result per vehicle.

        Raises:
            OrderFailed: a vehicle did not do it.
        """
        return await self.order(Intent("arm", self.config.select(vehicles)), timeout_s)

    async def locate(self, vehicles: Vehicles, *, timeout_s: float = 5.0) -> Results:
        """Let vehicles play a tune, so that an operator sees which ones they are.

        Args:
            vehicles: to order.
            timeout_s: longest wait for the end of the order [s].

        Returns:
            One result per vehicle.

        Raises:
            OrderFailed: a vehicle did not do it.
        """
        return await self.order(Intent("locate", self.config.select(vehicles)), timeout_s)

    identify = locate  # the former name, which missions may still use

    async def takeoff(
        self, height_m: float = DEFAULT_HEIGHT_M, vehicles: Vehicles = "all", *, timeout_s: float = 40.0
    ) -> Results:
        """Take off.

        Args:
            height_m: height above the fleet's origin [m].
            vehicles: to order.
            timeout_s: longest wait for the end of the order [s].

        Returns:
            One result per vehicle.

        Raises:
            OrderFailed: a vehicle did not do it.
        """
        return await self.order(Intent("takeoff", self.config.select(vehicles), height_m=height_m), timeout_s)

    async def move(
        self, position_enu_m: Vec3, vehicles: Vehicles = "all", *, duration_s: float = 0.0, timeout_s: float = 40.0
    ) -> Results:
        """Move one vehicle to a goal, or several in the formation that holds.

        Args:
            position_enu_m: goal of one vehicle, position of the formation of several [m], ENU.
            vehicles: to order.
            duration_s: of the move [s]; 0 leaves it to the vehicles' limits.
            timeout_s: longest wait for the end of the order [s].

        Returns:
            One result per vehicle.

        Raises:
            OrderFailed: a vehicle did not do it.
        """
        names = self.config.select(vehicles)
        return await self.order(Intent("move", names, position_enu_m=position_enu_m, duration_s=duration_s), timeout_s)

    async def formation(
        self,
        name: str,
        position_enu_m: Vec3,
        vehicles: Vehicles = "all",
        *,
        duration_s: float = 0.0,
        timeout_s: float = 40.0,
    ) -> Results:
        """Take up a formation at a position.

        Args:
            name: of the formation in the fleet file.
            position_enu_m: of the formation [m], ENU.
            vehicles: to order.
            duration_s: of the move [s]; 0 leaves it to the vehicles' limits.
            timeout_s: longest wait for the end of the order [s].

        Returns:
            One result per vehicle.

        Raises:
            ConfigError: the fleet file has no such formation.
            OrderFailed: a vehicle did not do it.
        """
        if name not in self.config.formations:
            known = ", ".join(self.config.formations) or "none"
            raise ConfigError(f"'{name}' is no formation of this fleet; it has {known}.")
        names = self.config.select(vehicles)
        if vehicles == "all":
            names = tuple(vehicle for vehicle in names if vehicle in self.config.formations[name])
        intent = Intent("formation", names, position_enu_m=position_enu_m, formation=name, duration_s=duration_s)
        return await self.order(intent, timeout_s)

    async def follow_path(
        self, paths: Paths, *, lights: Lights | None = None, on_lag: OnLag = "land", timeout_s: float | None = None
    ) -> Results:
        """Have each vehicle follow its own path, all from one instant on.

        Args:
            paths: of the vehicles, see :func:`groundstation.paths.files.load_path`.
            lights: colours of vehicles, see :func:`groundstation.paths.lights.load_lights`.
            on_lag: what a vehicle does that falls behind for too long; the others go on.
            timeout_s: longest flight along the paths [s]; None: their own duration, and a minute.

        Returns:
            One result per vehicle.

        Raises:
            OrderFailed: a vehicle does not take its path or does not start; then nobody does.
        """
        return await follow_paths(self, paths, lights=lights or {}, on_lag=on_lag, timeout_s=timeout_s)

    async def hold(self, vehicles: Vehicles = "all", *, timeout_s: float = 15.0) -> Results:
        """Hold the present position.

        Args:
            vehicles: to order.
            timeout_s: longest wait for the end of the order [s].

        Returns:
            One result per vehicle.

        Raises:
            OrderFailed: a vehicle did not do it.
        """
        return await self.order(Intent("hold", self.config.select(vehicles)), timeout_s)

    async def land(self, vehicles: Vehicles = "all", *, timeout_s: float = 40.0) -> Results:
        """Land and disarm.

        Args:
            vehicles: to order.
            timeout_s: longest wait for the end of the order [s].

        Returns:
            One result per vehicle.

        Raises:
            OrderFailed: a vehicle did not do it.
        """
        return await self.order(Intent("land", self.config.select(vehicles)), timeout_s)

    async def disarm(self, vehicles: Vehicles = "all", *, timeout_s: float = 15.0) -> Results:
        """Disarm on the ground.

        Args:
            vehicles: to order.
            timeout_s: longest wait for the end of the order [s].

        Returns:
            One result per vehicle.

        Raises:
            OrderFailed: a vehicle did not do it.
        """
        return await self.order(Intent("disarm", self.config.select(vehicles)), timeout_s)

    async def wait(self, duration_s: float) -> None:
        """Let time pass.

        Args:
            duration_s: seconds.
        """
        await asyncio.sleep(duration_s)

    async def fault(
        self,
        name: str,
        vehicles: Vehicles,
        *,
        after_s: float = 0.0,
        duration_s: float = 0.0,
        is_rehearsal: bool = False,
        **parameters: float | str,
    ) -> None:
        """Inject a fault into the emulator.

        Args:
            name: of the fault; `covey sitl --faults` lists them.
            vehicles: that have it.
            after_s: time from now until it begins, simulated seconds.
            duration_s: how long it lasts, simulated seconds; 0 for ever.
            is_rehearsal: only check whether it would be possible.
            parameters: of this fault.

        Raises:
            FaultRefused: the fault is impossible, or this flight is not simulated.
        """
        for vehicle in self.config.select(vehicles):
            sentence = await self.client.fault(
                name, vehicle, parameters, after_s=after_s, duration_s=duration_s, is_rehearsal=is_rehearsal
            )
            if not is_rehearsal:
                when = f" in {after_s:g} s" if after_s > 0.0 else ""
                self.say(f"fault{when}: {sentence}")

    async def order(self, intent: Intent, timeout_s: float) -> Results:
        """Give an order, wait for its end and log the results.

        Args:
            intent: the order.
            timeout_s: longest wait for its end [s].

        Returns:
            One result per vehicle.

        Raises:
            ConfigError: the order is none.
            OrderFailed: a vehicle did not do it.
        """
        self.say(f"{intent}")
        begin_ns = self.client.now_ns()
        order = await self.client.submit(intent)
        results = await order.wait(timeout_s)
        for name, message in order.planned.orders.items():
            if message.position_enu_m is not None:
                self.add_arrival(str(intent.verb), name, message.position_enu_m)
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

    def add_arrival(self, step: str, name: str, goal: Vec3) -> None:
        """Note how far a vehicle is from its goal now."""
        self.arrivals.append(arrival_of(step, self.state.vehicles[name], goal, self.client.now_ns()))

    async def land_all(self, timeout_s: float = 40.0) -> bool:
        """Land all vehicles that are not down yet. A landing under way goes on: no new order replaces an operator's.

        Args:
            timeout_s: longest wait [s].

        Returns:
            Whether all are landed and disarmed.
        """
        last = self.steps[-1].vehicles if self.steps else {}
        superseded = [name for name, phase in last.items() if phase == "superseded"]
        return await land_all(self.client, superseded, timeout_s, say=self.say)

    def _closest_words(self) -> str:
        near = smallest(self.state)
        return (
            "" if near is None else f"; smallest distance so far {near.distance_m:.2f} m ({near.first}, {near.second})"
        )


class MissionVehicle:
    """One vehicle of a fleet."""

    def __init__(self, fleet: Fleet, name: str) -> None:
        self._fleet = fleet
        self.name = name

    @property
    def position_enu_m(self) -> Vec3 | None:
        """Its reported position, metres ENU; None without a fresh valid one."""
        return self._fleet.state.vehicles[self.name].position_enu_m(self._fleet.client.now_ns())

    async def reached(self, position_enu_m: Vec3, within_m: float = ARRIVED_M, timeout_s: float = 40.0) -> bool:
        """Wait until it reports to be at a position.

        Args:
            position_enu_m: metres ENU.
            within_m: distance that counts as there [m].
            timeout_s: longest wait [s].

        Returns:
            Whether it was there in time.
        """

        def is_there(state: FleetState) -> bool:
            position = state.vehicles[self.name].position_enu_m(self._fleet.client.now_ns())
            return position is not None and math.dist(position, position_enu_m) <= within_m

        return await self._fleet.client.wait_for(is_there, timeout_s)

    async def takeoff(self, height_m: float = DEFAULT_HEIGHT_M, *, timeout_s: float = 40.0) -> VehicleResult:
        """Take off; as :meth:`Fleet.takeoff`."""
        return (await self._fleet.takeoff(height_m, self.name, timeout_s=timeout_s))[self.name]

    async def move(self, position_enu_m: Vec3, *, duration_s: float = 0.0, timeout_s: float = 40.0) -> VehicleResult:
        """Move to a goal; as :meth:`Fleet.move`."""
        results = await self._fleet.move(position_enu_m, self.name, duration_s=duration_s, timeout_s=timeout_s)
        return results[self.name]

    async def hold(self, *, timeout_s: float = 15.0) -> VehicleResult:
        """Hold the present position; as :meth:`Fleet.hold`."""
        return (await self._fleet.hold(self.name, timeout_s=timeout_s))[self.name]

    async def land(self, *, timeout_s: float = 40.0) -> VehicleResult:
        """Land and disarm; as :meth:`Fleet.land`."""
        return (await self._fleet.land(self.name, timeout_s=timeout_s))[self.name]
