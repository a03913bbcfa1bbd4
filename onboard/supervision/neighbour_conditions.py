"""What is wrong with the others: silence, lateness, broken promises, and distances that cannot be kept any more."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

from onboard.config.fleet import FleetConfig, Vec3, Vehicle
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightView, Step
from onboard.neighbours.table import COLUMNS, COLUMNS_1, SILENT_S, NeighbourTable
from onboard.safety.failsafe_table import Condition
from onboard.safety.separation import PredictionMonitor, smallest_distance_m
from onboard.types import GRAVITY_M_S2

_CONFIRM_TICKS = 2
_BACK_NS = 2_000_000_000
_NEAR_M = 5.0
_BRAKE_SHARE = 0.8
_PREDICTED_SLACK_M = 0.03
_PREDICTED_LOOKS = 2
_HELD_SHARE = 0.3
_STALE_LOOKS = 5
_X, _Y = (COLUMNS["position_enu_m"].start + axis for axis in (0, 1))
_VX, _VY = (COLUMNS["velocity_enu_m_s"].start + axis for axis in (0, 1))
_PREDICTED_VX, _PREDICTED_VY = (COLUMNS["predicted_velocity_enu_m_s"].start + axis for axis in (0, 1))
_LEAD = COLUMNS_1["lead_time_s"]


@dataclass(slots=True)
class NeighbourMonitor:
    """Looks at the table of neighbours; ``details`` gets the names that a condition speaks of."""

    fleet: FleetConfig
    vehicle: Vehicle
    table: NeighbourTable
    flight: FlightContext
    details: dict[Condition, str]
    _silent: tuple[str, ...] = ()
    _silent_ticks: int = 0
    _unseen_ticks: int = 0
    _back_ns: int = 0
    _promises: dict[str, PredictionMonitor] = field(init=False)
    _places: dict[str, int] = field(init=False)
    _predicted: int = 0
    _late: int = 0
    _held_up: Counter[int] = field(default_factory=Counter)
    _looks: int = 0
    _leg: int = -1
    _braking_m_s2: float = field(init=False)
    _own_hash: str = field(init=False)

    def __post_init__(self) -> None:
        self._promises = {name: PredictionMonitor() for name in self.table.names}
        self._places = {name: place for place, name in enumerate(self.table.names)}
        tilt_rad = math.radians(self.vehicle.max_tilt_deg)
        self._braking_m_s2 = _BRAKE_SHARE * GRAVITY_M_S2 * math.tan(tilt_rad)
        self._own_hash = self.fleet.config_hash

    def look(self, found: set[Condition], view: FlightView, nearest_m: float, is_airborne: bool, active: int) -> None:
        """What counts at every tick."""
        c, table, now_ns, limits = Condition, self.table, view.now_ns, self.fleet.fleet
        silent = table.silent(now_ns)
        self._silent_ticks = self._silent_ticks + 1 if silent else 0
        if self._silent_ticks >= _CONFIRM_TICKS:
            found.add(c.NEIGHBOUR_SILENT)
            self.details[c.NEIGHBOUR_SILENT] = ", ".join(silent)
            unseen = table.unseen(now_ns)
            self._unseen_ticks = self._unseen_ticks + 1 if unseen else 0
            if self._unseen_ticks >= _CONFIRM_TICKS:
                found.add(c.NEIGHBOUR_UNSEEN)
                self.details[c.NEIGHBOUR_UNSEEN] = ", ".join(unseen)
            gone, self._silent = self._silent, silent
        else:
            self._unseen_ticks = 0
            gone, self._silent = self._silent, ()
        if gone:
            heard = dict(zip(table.names, table.heard_ages_s(now_ns).tolist(), strict=True))
            back = [name for name in gone if name not in self._silent and heard[name] <= SILENT_S]
            if back:
                self._back_ns = now_ns
                self.details[c.NEIGHBOUR_BACK] = ", ".join(back)
        if self._back_ns and now_ns - self._back_ns < _BACK_NS:
            found.add(c.NEIGHBOUR_BACK)
        if nearest_m < limits.safety_distance_m and is_airborne:
            found.add(c.SEPARATION_BREACHED)
            if nearest_m < limits.body_diameter_m:
                touched = self.nearest_to(view.position_enu_m, limits.body_diameter_m, now_ns)
                if touched:
                    self.details[c.COLLISION_SUSPECTED] = touched
                    found.add(c.COLLISION_SUSPECTED)
        if self.flight.step is Step.LEG:
            if self._leg != self.flight.leg_count:
                self._leg = self.flight.leg_count
                self._looks = 0
                self._held_up.clear()
            self._looks += 1
            if active >= 0:
                self._held_up[active] += 1

    def look_slowly(self, view: FlightView) -> set[Condition]:
        """What counts ten times a second."""
        c, table, now_ns = Condition, self.table, view.now_ns
        found: set[Condition] = set()
        invalid = table.invalid()
        if invalid:
            self._tell(found, c.NEIGHBOUR_INVALID, invalid)
        stale = table.stale(now_ns)
        self._late = self._late + 1 if stale else 0
        if self._late >= _STALE_LOOKS:
            self._tell(found, c.NEIGHBOUR_STALE, stale)
        others = table.other_hashes(self._own_hash)
        if others:
            self._tell(found, c.CONFIG_DIFFERS, tuple(others))
        self._look_at_motion(found, view)
        return found

    def nearest_to(self, position_enu_m: Vec3, within_m: float, now_ns: int) -> str:
        """Who is nearest to a point, as far as known, and near enough; empty for nobody."""
        best, name = within_m, ""
        for row in self.table.rows(now_ns):
            if row.age_s < SILENT_S:
                where = zip(row.vector("position_enu_m"), row.vector("velocity_enu_m_s"), strict=True)
                apart_m = math.dist(position_enu_m, [p + row.age_s * v for p, v in where])
                if apart_m < best:
                    best, name = apart_m, row.name
        return name

    def held_up_by(self, goal_enu_m: Vec3, view: FlightView) -> str:
        """How far it still is from its goal, and whom the law kept it from on the way, in words."""
        left = f"still {math.dist(goal_enu_m, view.position_enu_m):.2f} m to go"
        often = [place for place, count in self._held_up.most_common(2) if count > _HELD_SHARE * self._looks]
        names = [self.table.names[place] for place in often if place < len(self.table.names)]
        return f"{left}, kept off by {' and '.join(names)}" if names else left

    def _look_at_motion(self, found: set[Condition], view: FlightView) -> None:
        table, flight = self.table, self.flight
        broken, endangered = [], []
        (x, y, _), (vx, vy, _) = view.position_enu_m, view.velocity_enu_m_s
        may_be_late = flight.is_under_law and view.has_position
        limit_m = self.fleet.fleet.safety_distance_m
        for row in table.rows(view.now_ns):
            numbers = row.numbers
            px, py, ovx, ovy = numbers[_X], numbers[_Y], numbers[_VX], numbers[_VY]
            promise, place = self._promises[row.name], self._places[row.name]
            if row.is_promised and row.age_s < SILENT_S:
                predicted = numbers[_PREDICTED_VX], numbers[_PREDICTED_VY]
                promise.look(row.stamp_ns, (ovx, ovy), predicted, numbers[_LEAD])
            else:
                promise.rest()
            if promise.is_broken:
                broken.append(row.name)
                table.distrusted.add(place)
            else:
                table.distrusted.discard(place)
            if not (may_be_late and row.age_s < SILENT_S and abs(px - x) < _NEAR_M and abs(py - y) < _NEAR_M):
                continue
            left_m = smallest_distance_m(
                (px - x, py - y),
                (vx - ovx, vy - ovy),
                reaction_s=self.vehicle.lag_s + row.age_s,
                deceleration_m_s2=self._braking_m_s2 * (2.0 if row.is_promised else 1.0),
            )
            if left_m < limit_m - _PREDICTED_SLACK_M and math.hypot(px - x, py - y) > limit_m:
                endangered.append(row.name)
        if broken:
            self._tell(found, Condition.NEIGHBOUR_UNCOOPERATIVE, tuple(broken))
        self._predicted = self._predicted + 1 if endangered else 0
        if self._predicted >= _PREDICTED_LOOKS:
            self._tell(found, Condition.SEPARATION_PREDICTED, tuple(endangered))

    def _tell(self, found: set[Condition], condition: Condition, names: tuple[str, ...]) -> None:
        found.add(condition)
        self.details[condition] = ", ".join(names)
