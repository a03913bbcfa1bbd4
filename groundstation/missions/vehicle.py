"""One vehicle of a mission's fleet: a group of one, with the live state of the vehicle.

A mission gets it as ``fleet["mav1"]``. The properties return what the last telemetry says.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from groundstation.fleet.state import FleetState, VehicleView
from groundstation.missions import conditions
from groundstation.missions.argument_checks import check_timeout
from groundstation.missions.conditions import ARRIVED_M, FleetMoment
from groundstation.missions.group import Group
from onboard.bus.schema import Telemetry
from onboard.tuples import Xyz


class LawValues(NamedTuple):
    """Values of the avoidance law of one vehicle, by its last telemetry."""

    law: str
    status: str  # inactive, saturated, relaxed or infeasible
    intervention_m_s2: float  # size of the change that the law makes to the acceleration
    avoids: str  # neighbour that causes most of this change; "" if there is none


class MissionVehicle(Group):
    """One vehicle of a fleet; its verbs are those of :class:`Group`."""

    @property
    def name(self) -> str:
        """Name in the fleet file."""
        return self._names[0]

    @property
    def view(self) -> VehicleView:
        """Everything that the ground knows of the vehicle."""
        return self.state.vehicles[self.name]

    @property
    def telemetry(self) -> Telemetry | None:
        """The last telemetry, however old; None before the first."""
        return self.view.telemetry

    @property
    def position_enu_m(self) -> Xyz | None:
        """The reported position [m], ENU; None without fresh telemetry with a valid position."""
        return self.view.position_enu_m(self.client.now_ns())

    @property
    def velocity_enu_m_s(self) -> Xyz | None:
        """The reported velocity [m/s], ENU; None without fresh telemetry."""
        view = self.view
        if view.telemetry is None or not view.is_fresh(self.client.now_ns()):
            return None
        return view.telemetry.velocity_enu_m_s

    @property
    def yaw_deg(self) -> float | None:
        """The reported heading, counterclockwise from east; None before the first telemetry."""
        return None if self.telemetry is None else self.telemetry.yaw_deg

    @property
    def battery_pct(self) -> float | None:
        """Charge in percent of a full battery; None before the first telemetry."""
        return None if self.telemetry is None else 100.0 * self.telemetry.battery_frac

    @property
    def is_flying(self) -> bool:
        """Whether the vehicle is in the air, by its last telemetry."""
        return self.view.is_airborne

    @property
    def law(self) -> LawValues | None:
        """Values of the vehicle's avoidance law; None before the first telemetry."""
        telemetry = self.telemetry
        if telemetry is None:
            return None

        return LawValues(
            law=telemetry.law,
            status=telemetry.law_status,
            intervention_m_s2=telemetry.intervention_m_s2,
            avoids=telemetry.avoids,
        )

    @property
    def neighbours(self) -> dict[str, float]:
        """Horizontal distances to the vehicles with known positions [m], the nearest first."""
        own_enu_m = self.position_enu_m
        if own_enu_m is None:
            return {}

        now_ns = self.client.now_ns()
        distances_m = {}
        for name, view in self.state.vehicles.items():
            other_enu_m = view.position_enu_m(now_ns)
            if name != self.name and other_enu_m is not None:
                distances_m[name] = math.dist(own_enu_m[:2], other_enu_m[:2])
        return dict(sorted(distances_m.items(), key=lambda item: item[1]))

    async def reached(
        self, position_enu_m: Xyz, within_m: float = ARRIVED_M, timeout_s: float = 40.0
    ) -> bool:
        """Wait until the vehicle reports to be at a position.

        Args:
            position_enu_m: position [m], ENU.
            within_m: distance from the position that counts as arrived [m].
            timeout_s: longest wait [s].

        Returns:
            Whether the vehicle arrived in time.

        Raises:
            ConfigError: the timeout is no number.
        """
        self.ground.check_not_ended()
        check_timeout(timeout_s, "reached")
        client = self.client
        arrival = conditions.reached({self.name: position_enu_m}, within_m)

        def has_arrived(state: FleetState) -> bool:
            return arrival.holds(FleetMoment(state, client.now_ns(), begin_ns=0))

        return await client.wait_for(has_arrived, timeout_s)
