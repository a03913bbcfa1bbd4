"""One vehicle of a mission's fleet: the verbs of a group, and its live state."""

from __future__ import annotations

import math
from typing import NamedTuple

from groundstation.fleet.state import VehicleView
from groundstation.missions.conditions import ARRIVED_M, Moment, reached
from groundstation.missions.group import Group
from onboard.bus.schema import Telemetry, Vec3


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
    def position_enu_m(self) -> Vec3 | None:
        """Its reported position, metres ENU; None without a fresh valid one."""
        return self.view.position_enu_m(self.client.now_ns())

    @property
    def velocity_enu_m_s(self) -> Vec3 | None:
        """Its reported velocity; None without fresh telemetry."""
        view = self.view
        return (
            None
            if view.telemetry is None or not view.is_fresh(self.client.now_ns())
            else view.telemetry.velocity_enu_m_s
        )

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
        own = self.telemetry
        return (
            None
            if own is None
            else LawValues(own.law, own.law_status, own.intervention_m_s2, own.avoids)
        )

    @property
    def neighbours(self) -> dict[str, float]:
        """Horizontal distances [m] to the others whose positions are known, the nearest first."""
        own, now_ns = self.position_enu_m, self.client.now_ns()
        if own is None:
            return {}
        known = {
            name: view.position_enu_m(now_ns)
            for name, view in self.state.vehicles.items()
            if name != self.name
        }
        away = {name: math.dist(own[:2], at[:2]) for name, at in known.items() if at is not None}
        return dict(sorted(away.items(), key=lambda one: one[1]))

    async def reached(
        self, position_enu_m: Vec3, within_m: float = ARRIVED_M, timeout_s: float = 40.0
    ) -> bool:
        """Wait until it reports to be at a position.

        Args:
            position_enu_m: metres ENU.
            within_m: distance that counts as there [m].
            timeout_s: longest wait [s].

        Returns:
            Whether it was there in time.
        """
        client, condition = self.client, reached({self.name: position_enu_m}, within_m)
        return await client.wait_for(
            lambda state: condition.holds(Moment(state, client.now_ns(), 0)), timeout_s
        )
