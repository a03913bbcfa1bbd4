"""One vehicle of a mission's fleet: the verbs of a group, and its live state."""

from __future__ import annotations

import math
from typing import NamedTuple

from groundstation.fleet.state import FleetState, VehicleView
from groundstation.missions.conditions import ARRIVED_M, FleetMoment, reached
from groundstation.missions.group import Group
from onboard.bus.schema import Telemetry
from onboard.tuples import Xyz


class LawValues(NamedTuple):
    """Values of the avoidance law of one vehicle, by its last telemetry."""

    law: str
    status: str  # inactive, saturated, relaxed or infeasible
    intervention_m_s2: float  # by how much it changes the commanded acceleration
    avoids: str  # the neighbour that this is mostly for; "" without one


class MissionVehicle(Group):
    """One vehicle of a fleet; its verbs are those of :class:`Group`."""

    @property
    def name(self) -> str:
        """Name in the fleet file."""
        return self._names[0]

    @property
    def view(self) -> VehicleView:
        """Everything that the ground knows of it."""
        return self.state.vehicles[self.name]

    @property
    def telemetry(self) -> Telemetry | None:
        """Its last telemetry, however old; None before the first."""
        return self.view.telemetry

    @property
    def position_enu_m(self) -> Xyz | None:
        """Its reported position, metres ENU; None without a fresh valid one."""
        return self.view.position_enu_m(self.client.now_ns())

    @property
    def velocity_enu_m_s(self) -> Xyz | None:
        """Its reported velocity; None without fresh telemetry."""
        view = self.view
        if view.telemetry is None or not view.is_fresh(self.client.now_ns()):
            return None
        return view.telemetry.velocity_enu_m_s

    @property
    def yaw_deg(self) -> float | None:
        """Its reported heading, counterclockwise from east; None before the first telemetry."""
        return None if self.telemetry is None else self.telemetry.yaw_deg

    @property
    def battery_pct(self) -> float | None:
        """Charge in percent of a full battery; None before the first telemetry."""
        return None if self.telemetry is None else 100.0 * self.telemetry.battery_frac

    @property
    def is_flying(self) -> bool:
        """Whether it is in the air, by its last telemetry."""
        return self.view.is_airborne

    @property
    def law(self) -> LawValues | None:
        """Values of its avoidance law; None before the first telemetry."""
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
        """Horizontal distances [m] to the others whose positions are known, the nearest first."""
        own_position = self.position_enu_m
        if own_position is None:
            return {}

        now_ns = self.client.now_ns()
        distances_m = {}
        for name, view in self.state.vehicles.items():
            position = view.position_enu_m(now_ns)
            if name != self.name and position is not None:
                distances_m[name] = math.dist(own_position[:2], position[:2])
        return dict(sorted(distances_m.items(), key=lambda item: item[1]))

    async def reached(
        self, position_enu_m: Xyz, within_m: float = ARRIVED_M, timeout_s: float = 40.0
    ) -> bool:
        """Wait until it reports to be at a position.

        Args:
            position_enu_m: metres ENU.
            within_m: distance that counts as there [m].
            timeout_s: longest wait [s].

        Returns:
            Whether it was there in time.
        """
        client = self.client
        condition = reached({self.name: position_enu_m}, within_m)

        def is_there(state: FleetState) -> bool:
            return condition.holds(FleetMoment(state, client.now_ns(), begin_ns=0))

        return await client.wait_for(is_there, timeout_s)
