"""Conditions about the other vehicles: silence, late messages, wrong predictions, and distances
about to be lost.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field

from onboard.config.fleet import FleetConfig, Vec3, Vehicle
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep, FlightView
from onboard.neighbours.plausibility import PlausibilityMonitor
from onboard.neighbours.state_arrays import NeighbourRow
from onboard.neighbours.table import NeighbourTable
from onboard.safety.failsafe_table import Condition
from onboard.safety.separation_monitor import PredictionMonitor, smallest_distance_m
from onboard.types import GRAVITY_M_S2

_CONFIRM_TICKS = 2
_BACK_NS = 2_000_000_000
_NEAR_M = 5.0
_CLIMB_S = 0.5  # for so long a climb or descent towards another is counted on
_BRAKE_SHARE = 0.8
_PREDICTED_SLACK_M = 0.03
_PREDICTED_CHECKS = 2
_KEPT_OFF_SHARE = 0.3
_STALE_CHECKS = 5
# whoever falls or is blown away may be faster than it flies
_FASTEST_M_S, _FASTEST_SHARE = 15.0, 3.0


@dataclass(slots=True)
class NeighbourMonitor:
    """Memory of the conditions about the other vehicles."""

    fleet: FleetConfig
    vehicle: Vehicle
    table: NeighbourTable
    flight: FlightContext
    details: dict[Condition, str]  # gets the names of the vehicles that a condition is about
    _silent: tuple[str, ...] = ()
    _silent_ticks: int = 0
    _unseen_ticks: int = 0
    _back_ns: int = 0
    _predictions: dict[str, PredictionMonitor] = field(init=False)
    _plausibilities: dict[str, PlausibilityMonitor] = field(init=False)
    _predicted_checks: int = 0
    _stale_checks: int = 0
    # index -> ticks of this leg in which the law avoided it
    _kept_off: Counter[int] = field(default_factory=Counter)
    _leg_ticks: int = 0
    _leg: int = -1
    _braking_m_s2: float = field(init=False)
    _vertical_m: float = field(init=False)  # vertical separation; infinite without one
    _own_hash: str = field(init=False)

    def __post_init__(self) -> None:
        self._predictions = {name: PredictionMonitor() for name in self.table.names}
        self._plausibilities = {
            name: PlausibilityMonitor(
                max(_FASTEST_M_S, _FASTEST_SHARE * self.fleet.vehicles[name].max_speed_m_s)
            )
            for name in self.table.names
        }
        tilt_rad = math.radians(self.vehicle.max_tilt_deg)
        self._braking_m_s2 = _BRAKE_SHARE * GRAVITY_M_S2 * math.tan(tilt_rad)
        self._own_hash = self.fleet.config_hash
        vertical_m = self.fleet.fleet.vertical_separation_m
        self._vertical_m = math.inf if vertical_m is None else vertical_m

    def check(
        self,
        active: set[Condition],
        view: FlightView,
        nearest_m: float,
        is_airborne: bool,
        active_neighbour: int,
    ) -> None:
        """Add the conditions that are checked at every tick; ``active_neighbour`` is the one that
        the law avoids.
        """
        self._check_silence(active, view.now_ns)
        limits = self.fleet.fleet
        if nearest_m < limits.safety_distance_m and is_airborne:
            active.add(Condition.SEPARATION_BREACHED)
            if nearest_m < limits.body_diameter_m:
                touched = self.nearest_to(view.position_enu_m, limits.body_diameter_m, view.now_ns)
                if touched:
                    self._add(active, Condition.COLLISION_SUSPECTED, (touched,))
        if self.flight.step is FlightStep.LEG:
            if self._leg != self.flight.leg_count:
                self._leg, self._leg_ticks = self.flight.leg_count, 0
                self._kept_off.clear()
            self._leg_ticks += 1
            if active_neighbour >= 0:
                self._kept_off[active_neighbour] += 1

    def _check_silence(self, active: set[Condition], now_ns: int) -> None:
        c, table = Condition, self.table
        silent = table.silent(now_ns)
        self._silent_ticks = self._silent_ticks + 1 if silent else 0
        if self._silent_ticks >= _CONFIRM_TICKS:
            self._add(active, c.NEIGHBOUR_SILENT, silent)
            unseen = table.unseen(now_ns)
            self._unseen_ticks = self._unseen_ticks + 1 if unseen else 0
            if self._unseen_ticks >= _CONFIRM_TICKS:
                self._add(active, c.NEIGHBOUR_UNSEEN, unseen)
            before, self._silent = self._silent, silent
        else:
            self._unseen_ticks = 0
            before, self._silent = self._silent, ()
        if before:
            ages_s = dict(zip(table.names, table.heard_ages_s(now_ns).tolist(), strict=True))
            back = [
                name
                for name in before
                if name not in self._silent and ages_s[name] <= table.silent_s
            ]
            if back:
                self._back_ns = now_ns
                self.details[c.NEIGHBOUR_BACK] = ", ".join(back)
        if self._back_ns and now_ns - self._back_ns < _BACK_NS:
            active.add(c.NEIGHBOUR_BACK)

    def check_slowly(self, view: FlightView) -> set[Condition]:
        """Return the conditions that are checked ten times a second."""
        c, table, now_ns = Condition, self.table, view.now_ns
        active: set[Condition] = set()
        invalid = table.invalid()
        if invalid:
            self._add(active, c.NEIGHBOUR_INVALID, invalid)
        stale = table.stale(now_ns)
        self._stale_checks = self._stale_checks + 1 if stale else 0
        if self._stale_checks >= _STALE_CHECKS:
            self._add(active, c.NEIGHBOUR_STALE, stale)
        others = table.other_hashes(self._own_hash)
        if others:
            self._add(active, c.CONFIG_DIFFERS, others)
        rows = table.rows(now_ns)
        contradicted = self._check_plausibility(active, rows, now_ns)
        self._check_predictions(active, rows, {*others, *contradicted})
        self._check_distances(active, rows, view)
        return active

    def nearest_to(self, position_enu_m: Vec3, within_m: float, now_ns: int) -> str:
        """Return the neighbour nearest to a point, as far as known and within a distance; empty for
        none.
        """
        nearest_m, name = within_m, ""
        for row in self.table.rows(now_ns):
            if row.age_s < self.table.silent_s:
                motion = zip(
                    row.vector("position_enu_m"), row.vector("velocity_enu_m_s"), strict=True
                )
                apart_m = math.dist(position_enu_m, [p + row.age_s * v for p, v in motion])
                if apart_m < nearest_m:
                    nearest_m, name = apart_m, row.name
        return name

    def kept_off_by(self, goal_enu_m: Vec3, view: FlightView) -> str:
        """Return in words how far the goal is, and the neighbours that the law avoided on the way."""
        rest = f"still {math.dist(goal_enu_m, view.position_enu_m):.2f} m to go"
        least = _KEPT_OFF_SHARE * self._leg_ticks
        often = [index for index, count in self._kept_off.most_common(2) if count > least]
        names = [self.table.names[index] for index in often if index < len(self.table.names)]
        return f"{rest}, kept off by {' and '.join(names)}" if names else rest

    def _check_plausibility(
        self, active: set[Condition], rows: Iterable[NeighbourRow], now_ns: int
    ) -> dict[str, str]:
        """Compare what each neighbour says with physics and the mocap; return whom not to believe,
        and why.
        """
        reasons = {}
        for row in rows:
            monitor, (claim, seen) = self._plausibilities[row.name], self.table.claim(row.name)
            if claim is not None:
                monitor.look(claim, seen, now_ns)
            is_contradicted = bool(monitor.reason)
            index = self.table.indices[row.name]
            self.table.judged.set_watched(index, monitor.is_watched)
            self.table.judged.set_contradicted(index, is_contradicted)
            if is_contradicted:
                reasons[row.name] = monitor.reason
        if reasons:
            self._add(
                active,
                Condition.NEIGHBOUR_IMPLAUSIBLE,
                [f"{name} {why}" for name, why in reasons.items()],
            )
        return reasons

    def _check_predictions(
        self, active: set[Condition], rows: Iterable[NeighbourRow], others: Collection[str]
    ) -> None:
        """Compare how each neighbour flies with how it predicted to fly; ``others`` are not to be
        counted on.
        """
        wrong = []
        for row in rows:
            monitor = self._predictions[row.name]
            if row.is_cooperative and row.age_s < self.table.silent_s:
                vx, vy, _ = row.vector("velocity_enu_m_s")
                px, py, _ = row.vector("predicted_velocity_enu_m_s")
                monitor.update(row.stamp_ns, (vx, vy), (px, py), row.value("lead_time_s"))
            else:
                monitor.reset()
            if monitor.is_wrong:
                wrong.append(row.name)
            is_not_cooperating = monitor.is_wrong or row.name in others
            self.table.judged.set_not_cooperating(self.table.indices[row.name], is_not_cooperating)
        if wrong:
            self._add(active, Condition.NEIGHBOUR_UNCOOPERATIVE, wrong)

    def _check_distances(
        self, active: set[Condition], rows: Iterable[NeighbourRow], view: FlightView
    ) -> None:
        """Find neighbours from which even hard braking will not keep the safety distance."""
        endangered = []
        if self.flight.is_under_law and view.has_position:
            known = [row for row in rows if row.age_s < self.table.silent_s]
            endangered = [row.name for row in known if self._is_endangered(row, view)]
        self._predicted_checks = self._predicted_checks + 1 if endangered else 0
        if self._predicted_checks >= _PREDICTED_CHECKS:
            self._add(active, Condition.SEPARATION_PREDICTED, endangered)

    def _is_endangered(self, row: NeighbourRow, view: FlightView) -> bool:
        (x, y, z), (vx, vy, vz) = view.position_enu_m, view.velocity_enu_m_s
        other_x, other_y, other_z = row.vector("position_enu_m")
        other_vx, other_vy, other_vz = row.vector("velocity_enu_m_s")
        apart_m = other_x - x, other_y - y
        if max(map(abs, apart_m)) >= _NEAR_M:
            return False
        apart_z_m = z - other_z
        closing_m_s = (other_vz - vz) * math.copysign(1.0, apart_z_m)
        # it lands, falls or is silent above
        claims_column = not row.is_cooperative and apart_z_m < 0.0
        if (
            not claims_column
            and abs(apart_z_m) - _CLIMB_S * max(closing_m_s, 0.0) >= self._vertical_m
        ):
            return False
        left_m = smallest_distance_m(
            apart_m,
            (vx - other_vx, vy - other_vy),
            reaction_s=self.vehicle.lag_s + row.age_s,
            deceleration_m_s2=self._braking_m_s2 * (2.0 if row.is_cooperative else 1.0),
        )
        limit_m = self.fleet.fleet.safety_distance_m
        return left_m < limit_m - _PREDICTED_SLACK_M and math.hypot(*apart_m) > limit_m

    def _add(self, active: set[Condition], condition: Condition, names: Iterable[str]) -> None:
        active.add(condition)
        self.details[condition] = ", ".join(names)
