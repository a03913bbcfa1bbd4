"""An order before it is sent: planned, forecast, shown, and checked again.

The console's preview and the page in the browser show the same: the planned order, every reason
against sending it, and its paths and smallest distance as soon as they are computed. If the fleet
has moved meanwhile, the forecast is computed again. If somebody has stopped one of its vehicles
meanwhile, the order is refused. When the operator sends the order, it is checked against the fleet
at that time. Only an order that was shown and that passes this check is sent.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Protocol

from groundstation.fleet.answered_stops import answered_stop
from groundstation.fleet.state import FleetState
from groundstation.orders.battery_reserve import Discharge, weakest
from groundstation.orders.forecast import SEEDS, Forecast, Leg, objections
from groundstation.orders.forecast_process import ForecastFailed
from groundstation.orders.intents import Intent, Takeoff
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.preview import OrderPreview, changed, preview_order
from groundstation.orders.result import OrderResult
from onboard.bus.control_token import EMERGENCY
from onboard.config.fleet import FleetConfig
from onboard.plain_text import listed

_WITH_BATTERY = ("skip", "bring_home", "home")  # verbs whose preview shows the weakest battery


class PlansOrders(Protocol):
    """The part of a client that plans orders."""

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""

    def now_ns(self) -> int:
        """Return the present time of the clock from which ages are computed [ns]."""

    def plan(self, order: Intent | str) -> PlannedOrder:
        """Plan an order and check it; nothing is sent."""

    def check_again(self, planned: PlannedOrder) -> PlannedOrder:
        """Check a planned order against the present fleet."""

    def is_of_mission(self, order_id: str) -> bool:
        """Whether a mission of this ground has given an order."""

    def is_own(self, order_id: str) -> bool:
        """Whether this ground has given an order."""

    def newest_order(self, vehicle: str) -> OrderResult | None:
        """Return the newest order that this ground has given a vehicle."""


class FliesAhead(Protocol):
    """A forecaster, which flies an order ahead in a simulation."""

    async def forecast(
        self, fleet: FleetConfig, legs: Mapping[str, Leg], *, is_takeoff: bool = False
    ) -> Forecast:
        """Compute a forecast."""


class PreparedOrder:
    """One order that may be sent, or not.

    Args:
        fleet: the fleet file.
        client: client that plans and checks orders.
        intent: order that is prepared.
        forecaster: computes the paths.
        start: function that begins a computation; it first ends a computation that still runs.
        on_change: function that is called whenever the shown values have changed.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        client: PlansOrders,
        intent: Intent,
        forecaster: FliesAhead,
        *,
        start: Callable[[OrderPreview], object],
        on_change: Callable[[], object],
    ) -> None:
        self.fleet = fleet
        self.client = client
        self.intent = intent  # after the planning, with the values that were left open

        self.preview: OrderPreview | None = None
        self.forecast: Forecast | None = None
        self.reasons: tuple[str, ...] = ()  # reasons against sending it
        self.is_computing = True
        self.note = ""  # reason why it was computed again
        self.begun_ns = client.now_ns()  # start of the computation

        self._forecaster = forecaster
        self._start = start
        self._on_change = on_change

        self._prepared_ns = client.now_ns()
        self._stops: list[str] = []  # who has stopped vehicles since; once found, it stays
        # vehicle -> newest order that it had taken when this one was prepared, and the newest one
        # that this ground had sent it, which may still be on its way
        self._earlier_order_ids: dict[str, set[str]] = {}
        for name, view in client.state.vehicles.items():
            if view.telemetry is None:
                continue
            self._earlier_order_ids[name] = {view.telemetry.taken_order_id}
            sent = client.newest_order(name)
            if sent is not None:
                self._earlier_order_ids[name].add(sent.planned.orders[name].order_id)

    @property
    def is_sendable(self) -> bool:
        """Whether the order may be sent now."""
        return not self.is_computing and not self.reasons and self.preview is not None

    def begin(self, note: str = "") -> None:
        """Plan the order for the present fleet, and begin to compute its paths.

        Args:
            note: reason for computing it again; empty at first.
        """
        state = self.client.state
        now_ns = self.client.now_ns()
        self.begun_ns = now_ns
        self.note = note

        self.preview = preview_order(self.client.plan(self.intent), state, now_ns)
        self.intent = self.preview.intent
        self.forecast = None
        self.reasons = (*self._stops_since(), *self.preview.reasons)

        self.is_computing = not self.reasons and self.intent.verb != "arm"
        if self.is_computing:
            self._start(self.preview)
        self._on_change()

    async def compute(self, preview: OrderPreview) -> None:
        """Compute the paths of a preview; drop them if the preview is no longer shown.

        Args:
            preview: preview that ``start`` was given.
        """
        is_takeoff = preview.intent.verb == "takeoff"
        forecast: Forecast | None = None
        try:
            forecast = await self._forecaster.forecast(
                self.fleet, preview.legs, is_takeoff=is_takeoff
            )
            reasons = (*preview.reasons, *objections(forecast, preview.intent, self.fleet))
        except ForecastFailed as error:
            reasons = (str(error),)

        if preview is self.preview:
            self.forecast = forecast
            self.is_computing = False
            self.reasons = reasons
            self._on_change()

    def check(self) -> PlannedOrder | None:
        """Check the shown order against the present fleet.

        Returns:
            The order that has passed the check; None if it is computed again after a change, or
                refused because somebody has stopped a vehicle.
        """
        if self.preview is None:
            return None

        if not set(self._stops_since()) <= set(self.reasons):
            self.begin()
            return None

        checked = self.client.check_again(self.preview.planned)
        change = changed(self.preview, checked, self.client.state, self.client.now_ns())
        if change is not None:
            self.begin(f"{change}: computed again")
            return None
        return checked

    def _stops_since(self) -> list[str]:
        """Return who has stopped vehicles of this order since it was prepared, in sentences.

        A person's order to land, to hold or to kill stays until somebody who knows of it orders
        anew, however often this order is computed meanwhile. An order of this ground's own mission
        is no such order.
        """
        stopped: dict[tuple[str, str], list[str]] = {}  # author and verb -> vehicles
        for name in self.intent.names:
            view = self.client.state.vehicles.get(name)
            telemetry = None if view is None else view.telemetry
            if telemetry is None or telemetry.taken_order_kind not in EMERGENCY:
                continue

            order_id = telemetry.taken_order_id
            is_earlier = order_id in self._earlier_order_ids.get(name, {order_id})
            if not is_earlier and not self.client.is_of_mission(order_id):
                order = (telemetry.taken_order_from, telemetry.taken_order_kind)
                stopped.setdefault(order, []).append(name)

        stops = [
            f"{author} has ordered {verb} {listed(names)}"
            for (author, verb), names in stopped.items()
        ]
        answered = answered_stop(
            self.client.state, self.intent.names, self._prepared_ns, self.client.is_own
        )
        if answered and not stops:
            stops = [answered]
        if stops:
            self._stops = [
                f"{words} meanwhile: look at the vehicles, then order again." for words in stops
            ]
        return self._stops

    def figures(self) -> list[str]:
        """Return smallest distance, limit and duration, one line each."""
        if self.intent.verb == "arm":
            return ["The propellers turn. Keep clear.", self._closest_now()]

        forecast = self.forecast
        if forecast is None:
            return []

        lines = []
        if math.isfinite(forecast.closest_m):
            pair = " and ".join(forecast.pair)
            limit_m = self.fleet.fleet.safety_distance_m
            lines += [
                f"closest: {forecast.closest_m:.2f} m, {pair}, after {forecast.closest_s:.1f} s",
                f"limit:   {limit_m:.2f} m    now: {forecast.now_m:.2f} m",
            ]
        if math.isfinite(forecast.duration_s):
            lines.append(f"takes about {forecast.duration_s:.0f} s")
        lines += self._battery_lines()
        if isinstance(self.intent, Takeoff) and len(self.intent.waves) > 1:
            lines.append(
                f"in {len(self.intent.waves)} waves of {self.intent.by}, each takes that long, "
                f"{self.intent.every_s:g} s between: one that fails stops the later ones"
            )
        if 0 < forecast.flight_count < len(SEEDS):
            times = "once" if forecast.flight_count == 1 else f"{forecast.flight_count} times"
            lines.append(f"flown ahead {times}")
        return lines

    def _battery_lines(self) -> list[str]:
        """Return the weakest battery, for orders that end a show or bring vehicles home."""
        if self.intent.verb not in _WITH_BATTERY:
            return []

        reserve = weakest(
            self.fleet,
            self.client.state,
            self.intent.names,
            discharge=Discharge(),
            now_ns=self.client.now_ns(),
        )
        if reserve is None:
            return ["weakest battery: not reported"]
        return [
            f"weakest battery: {reserve.name}, {reserve.has_pct:.0f} %",
            f"leaves for home at {reserve.needs_pct:.0f} % at the latest",
        ]

    def _closest_now(self) -> str:
        now = self.client.state.closest(self.client.now_ns())
        if now is None:
            return ""
        return f"closest now: {now.distance_m:.2f} m, {now.first} and {now.second}"
