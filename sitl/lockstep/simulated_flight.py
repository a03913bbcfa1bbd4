"""Opens a lockstep flight with its settings: weather, faults, orders of another ground, changes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from groundstation.client.client import FleetClient
from groundstation.flights.changes import Change, edited_fleet, timed_change
from groundstation.flights.recorded_flight import fleet_of
from groundstation.flights.simulation_settings import (
    SimulationSettings,
    TimedOrder,
    order_for,
    timed_order,
    wind_of,
)
from groundstation.orders import grammar
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.control.pipeline import pipeline_params
from onboard.rollout.first_compilation import compile_law
from sitl.emulator.emulator import Environment
from sitl.faults.catalogue import FaultError, parse
from sitl.lockstep.connections import BusSettings
from sitl.lockstep.flight import Lockstep
from sitl.physics.wind import WindSettings

OTHER_GROUND = "ground-2"
OTHER_AUTHOR = "another operator"

# longest time that the second ground waits for telemetry of all vehicles before it gives its order
_HEARS_ALL_S = 2.0
_LANDING_S = 60.0  # longer than a landing takes


def open_flight(
    fleet: FleetConfig,
    settings: SimulationSettings,
    folder: Path | None,
    *,
    say: Callable[[str], None] = lambda line: None,
) -> Lockstep:
    """Return a flight that has not begun, with the faults, orders and changes of the settings.

    Args:
        fleet: the fleet file whose vehicles fly.
        settings: settings of the simulation.
        folder: the folder of the record; None records nothing.
        say: called with each line of progress.

    Raises:
        ConfigError: a fault, an order or a change is impossible.
    """
    if len(fleet.enabled_names) > 1:  # interpreted code computes a single vehicle
        compile_law()

    environment = None
    if any(settings.wind_enu_m_s) or settings.gust_m_s:
        environment = Environment(wind=_wind_settings(settings))

    flight = Lockstep(
        fleet,
        seed=settings.seed,
        bus=_bus_settings(settings.bus),
        environment=environment,
        folder=folder,
        as_if_recorded=True,
        say=say,
    )
    try:
        _plan(flight, settings)
    except ConfigError:
        flight.close()
        raise
    return flight


def _wind_settings(settings: SimulationSettings) -> WindSettings:
    east_m_s, north_m_s = settings.wind_enu_m_s
    return WindSettings(
        mean_enu_m_s=(east_m_s, north_m_s, 0.0),
        gust_std_m_s=settings.gust_m_s,
    )


def _bus_settings(values: dict[str, float]) -> BusSettings:
    unknown = set(values) - set(BusSettings.__dataclass_fields__)
    if unknown:
        known = ", ".join(BusSettings.__dataclass_fields__)
        raise ConfigError(f"The bus has no '{min(unknown)}'; it has {known}.")
    return BusSettings(**values)


def _plan(flight: Lockstep, settings: SimulationSettings) -> None:
    """Plan the faults, the orders and the changes."""
    for line in settings.faults:
        try:
            flight.inject(parse(line))
        except FaultError as error:
            raise ConfigError(f"The fault '{line}': {error}") from None

    other_ground = OtherGround(flight)
    for line in settings.orders:
        other_ground.plan(order_for(flight.config, line))

    for line in settings.changes:
        at_s, change = timed_change(line)
        apply = _prepared_change(flight, change)
        flight.at(at_s, apply)


def longest_stay_s(settings: SimulationSettings) -> float:
    """Return how long a flight goes on at most after an order has taken the fleet from its mission.

    Nobody gives an order that is not planned, so that after the last one vehicles land or hold.

    Args:
        settings: settings of the flight.
    """
    last_order_s = max((timed_order(line).at_s for line in settings.orders), default=0.0)
    return last_order_s + _LANDING_S


def never_happened(settings: SimulationSettings, end_s: float) -> list[str]:
    """Return a sentence for each fault, order and change whose time the flight did not reach.

    Args:
        settings: settings of a flight that has ended.
        end_s: simulated time of its end.
    """
    times_s = {f"The fault '{line}'": parse(line).at_s for line in settings.faults}
    times_s |= {f"The order '{line}'": timed_order(line).at_s for line in settings.orders}
    times_s |= {f"The change '{line}'": timed_change(line)[0] for line in settings.changes}
    return [
        f"{what} never happened: the flight ended at {end_s:.1f} s."
        for what, at_s in times_s.items()
        if at_s > end_s
    ]


def _prepared_change(flight: Lockstep, change: Change) -> Callable[[], None]:
    """Return a function that makes a change while the flight is under way.

    Raises:
        ConfigError: the change is impossible.
    """
    wind = flight.simulation.emulator.world.wind
    if change.key == "wind":
        east_m_s, north_m_s = wind_of(change.value)
        return lambda: wind.change_mean((east_m_s, north_m_s, 0.0), over_s=0.0)

    if change.key == "gust":
        gust_m_s = float(change.value)
        return lambda: wind.change_gusts(gust_m_s)

    if change.key.startswith("bus."):
        name = change.key.removeprefix("bus.")
        values = {name: float(change.value)}
        _bus_settings(values)
        bus = flight.bus
        return lambda: bus.change_settings(replace(bus.settings, **values))

    return _prepared_law(flight, change)


def _prepared_law(flight: Lockstep, change: Change) -> Callable[[], None]:
    """Return a function that changes a parameter of the law in all agents."""
    fleet = flight.config
    changed_fleet = fleet_of(edited_fleet(fleet.text, change), Path(fleet.path))

    def apply() -> None:
        for name, agent in flight.agents.items():
            agent.core.control.params = pipeline_params(changed_fleet, name)

    return apply


class OtherGround:
    """A second ground station, run by someone else, that gives orders at planned times.

    It joins the bus for its first order, and gives the order as soon as it has telemetry of all
    vehicles. It is not the operator: its orders to hold, land, kill and pause are accepted, and its
    other orders are refused. An event tells of each order that did not end as ordered.

    Args:
        flight: the flight whose bus it joins.
    """

    def __init__(self, flight: Lockstep) -> None:
        self._flight = flight
        self._client: FleetClient | None = None

    def plan(self, order: TimedOrder) -> None:
        """Plan an order at its time."""
        self._flight.at(order.at_s, lambda: self._flight.start_soon(self._give(order)))

    async def _give(self, order: TimedOrder) -> None:
        client = await self._joined()
        names = self._flight.config.enabled_names
        await client.wait_for(
            lambda state: all(state.vehicles[name].telemetry for name in names), _HEARS_ALL_S
        )
        try:
            result = await client.submit(order.text)
        except grammar.OrderError as error:
            self._tell(order, str(error))
            return

        for answer in (await result.wait()).values():
            if not answer.is_done:
                self._tell(order, answer.words)

    def _tell(self, order: TimedOrder, outcome: str) -> None:
        """Publish an event of the first ground, because only that ground's events are recorded."""
        sentence = f"Order '{order.text}' of {OTHER_GROUND}: {outcome}"
        self._flight.client.publish_event("warning", "order-of-other", sentence)

    async def _joined(self) -> FleetClient:
        if self._client is None:
            self._client = FleetClient(
                self._flight.config,
                author=OTHER_AUTHOR,
                operates=False,
                bus=self._flight.simulation.bus.node(OTHER_GROUND),
                clock_ns=self._flight.simulation.clock_ns,
            )
            await self._client.start()
        return self._client
