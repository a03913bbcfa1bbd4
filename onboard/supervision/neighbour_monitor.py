"""Detects problems with the other vehicles: silence, late messages, wrong predictions, and safety
distances that will be violated.

The tick observer checks for silence at every tick, and for the other problems ten times a second.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable
from typing import NamedTuple

from onboard.bus.schema import Telemetry
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.constants import GRAVITY_M_S2
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightView
from onboard.neighbours.plausibility import PlausibilityMonitor
from onboard.neighbours.state_arrays import NeighbourRow
from onboard.neighbours.table import NeighbourTable
from onboard.safety.condition_timer import ConditionTimer
from onboard.safety.failsafe_table import Condition
from onboard.safety.limits import NEIGHBOUR_BLIND_S
from onboard.safety.separation_monitor import PredictionMonitor, smallest_distance_m
from onboard.supervision.condition_table import NEIGHBOUR_CHECKS
from onboard.tuples import Xyz

# A vehicle with one of these conditions lands because of the wind.
_TOO_WINDY = frozenset({Condition.WIND_ABOVE.value, Condition.PUSHED_ABOUT.value})
_BACK_NS = 2_000_000_000  # a neighbour is reported as heard again for this time
_NEAR_M = 5.0  # a neighbour farther away along an axis is not checked
_CLIMB_S = 0.5  # a climb or descent towards a neighbour is expected to continue for this time
# deceleration that the distance check expects, as a share of the deceleration at the largest tilt
_BRAKE_SHARE = 0.8
_PREDICTED_SLACK_M = 0.03  # a predicted distance may be this far below the safety distance
# a neighbour is reported if the law avoided it in more than this share of a leg's ticks
_KEPT_OFF_SHARE = 0.3

# A vehicle may fall or be blown away, so its largest plausible speed is the larger of these:
_FASTEST_M_S = 15.0
_FASTEST_SHARE = 3.0  # of its max_speed_m_s


class Silence(NamedTuple):
    """Names of neighbours that became silent, or that are heard again."""

    silent: tuple[str, ...]  # were in the air when last heard, and are silent at this tick
    unseen: tuple[str, ...]  # silent for several ticks, and not seen by the mocap either
    heard_again: tuple[str, ...]  # heard again within the last seconds


class SlowNeighbourFacts(NamedTuple):
    """Names of neighbours with a problem, from the check ten times a second.

    :class:`onboard.supervision.tick_facts.SlowFacts` explains each of them.
    """

    without_position: tuple[str, ...]
    blind: tuple[str, ...]
    late: tuple[str, ...]
    other_files: tuple[str, ...]
    implausible: tuple[str, ...]  # each name with its reason
    uncooperative: tuple[str, ...]
    too_windy_for: tuple[str, ...]
    endangered: tuple[str, ...]


class NeighbourMonitor:
    """Memory of the other vehicles as one agent sees them."""

    def __init__(
        self, fleet: FleetConfig, vehicle: Vehicle, table: NeighbourTable, flight: FlightContext
    ) -> None:
        self._limits = fleet.fleet
        self._vehicle = vehicle
        self._table = table
        self._flight = flight
        self._own_hash = fleet.config_hash
        tilt_rad = math.radians(vehicle.max_tilt_deg)
        self._braking_m_s2 = _BRAKE_SHARE * GRAVITY_M_S2 * math.tan(tilt_rad)
        # beyond this vertical distance, no horizontal distance is needed; infinite: always needed
        self._vertical_m = math.inf
        if fleet.fleet.vertical_separation_m is not None:
            self._vertical_m = fleet.fleet.vertical_separation_m

        self._predictions = {name: PredictionMonitor() for name in table.names}
        self._plausibilities = {
            name: PlausibilityMonitor(
                max(_FASTEST_M_S, _FASTEST_SHARE * fleet.vehicles[name].max_speed_m_s)
            )
            for name in table.names
        }

        # counts the ticks in a row in which any neighbour was silent
        self._silence = ConditionTimer()
        self._confirmed_silent: tuple[str, ...] = ()  # silent in enough ticks in a row
        self._heard_again: tuple[str, ...] = ()
        self._heard_again_ns = 0

        # index of a neighbour -> number of ticks of this leg in which the law avoided it
        self._kept_off: Counter[int] = Counter()
        self._leg_ticks = 0
        self._leg = -1  # number of this leg; -1: none yet

    def update(self, now_ns: int) -> Silence:
        """Return which neighbours are silent at this tick; call it at every tick."""
        silent = self._table.silent(now_ns)
        if silent:
            self._silence.see(now_ns)
        else:
            self._silence.end()

        silent_before = self._confirmed_silent
        unseen: tuple[str, ...] = ()
        if self._silence.checks >= NEIGHBOUR_CHECKS:
            self._confirmed_silent = silent
            unseen = self._table.unseen(now_ns)
        else:
            self._confirmed_silent = ()

        if silent_before:
            self._find_heard_again(silent_before, now_ns)
        heard_again: tuple[str, ...] = ()
        if self._heard_again_ns != 0 and now_ns - self._heard_again_ns < _BACK_NS:
            heard_again = self._heard_again
        return Silence(silent, unseen, heard_again)

    def _find_heard_again(self, silent_before: Iterable[str], now_ns: int) -> None:
        """Find the neighbours that were silent before and are heard now."""
        table = self._table
        ages_s = dict(zip(table.names, table.heard_ages_s(now_ns).tolist(), strict=True))
        heard_again = []
        for name in silent_before:
            if name not in self._confirmed_silent and ages_s[name] <= table.silent_s:
                heard_again.append(name)
        if heard_again:
            self._heard_again = tuple(heard_again)
            self._heard_again_ns = now_ns

    def count_avoided(self, active_neighbour: int) -> None:
        """Count the neighbour that the law avoids at this tick of a leg; -1 for none."""
        if self._leg != self._flight.leg_count:
            self._leg = self._flight.leg_count
            self._leg_ticks = 0
            self._kept_off.clear()

        self._leg_ticks += 1
        if active_neighbour >= 0:
            self._kept_off[active_neighbour] += 1

    def kept_off_by(self, goal_enu_m: Xyz, view: FlightView) -> str:
        """Return in words how far the goal is, and which neighbours the law avoided on the way."""
        distance = f"still {math.dist(goal_enu_m, view.position_enu_m):.2f} m to go"

        least = _KEPT_OFF_SHARE * self._leg_ticks
        often = [index for index, count in self._kept_off.most_common(2) if count > least]
        all_names = self._table.avoided_names
        names = [all_names[index] for index in often if index < len(all_names)]
        if not names:
            return distance
        return f"{distance}, kept off by {' and '.join(names)}"

    def nearest_to(self, position_enu_m: Xyz, within_m: float, now_ns: int) -> str:
        """Return the name of the neighbour nearest to a point within a distance; empty: none.

        Silent neighbours do not count.
        """
        nearest_m = within_m
        name = ""
        for row in self._table.rows(now_ns):
            if row.age_s >= self._table.silent_s:
                continue
            motion = zip(row.vector("position_enu_m"), row.vector("velocity_enu_m_s"), strict=True)
            now_enu_m = [p + row.age_s * v for p, v in motion]
            apart_m = math.dist(position_enu_m, now_enu_m)
            if apart_m < nearest_m:
                nearest_m = apart_m
                name = row.name
        return name

    def update_slowly(self, view: FlightView) -> SlowNeighbourFacts:
        """Return which neighbours have a problem, and mark them in the table.

        Call it ten times a second.
        """
        now_ns = view.now_ns
        table = self._table
        without_position = table.invalid()
        late = table.stale(now_ns)
        other_files = tuple(table.other_hashes(self._own_hash, now_ns))

        rows = table.rows(now_ns)
        implausible = self._check_plausibility(now_ns)
        uncooperative = self._check_predictions(rows, {*other_files, *implausible})
        endangered = self._check_distances(rows, view)
        telemetries = self._heard_telemetries(rows)
        return SlowNeighbourFacts(
            without_position=without_position,
            blind=_blind(telemetries, view),
            late=late,
            other_files=other_files,
            implausible=tuple(f"{name} {reason}" for name, reason in implausible.items()),
            uncooperative=uncooperative,
            too_windy_for=_too_windy_for(telemetries),
            endangered=endangered,
        )

    def _heard_telemetries(self, rows: Iterable[NeighbourRow]) -> list[Telemetry]:
        """Return the telemetry of each neighbour that is not silent."""
        telemetries = self._table.telemetries()
        heard = [row.name for row in rows if row.age_s < self._table.silent_s]
        return [telemetries[name] for name in heard if name in telemetries]

    def _check_plausibility(self, now_ns: int) -> dict[str, str]:
        """Compare each neighbour's messages with physics and the mocap.

        Returns:
            Name -> reason, for each neighbour whose messages cannot be true.
        """
        reasons = {}
        for name in self._table.names_to_check:
            monitor = self._plausibilities[name]
            # motion in the neighbour's newest message, and position of its body from the mocap
            claim, mocap_position = self._table.claim(name)
            if claim is not None:
                monitor.update(claim, mocap_position, now_ns)

            index = self._table.indices[name]
            is_contradicted = bool(monitor.reason)
            self._table.judged.set_watched(index, monitor.is_watched)
            self._table.judged.set_contradicted(index, is_contradicted)
            if is_contradicted:
                reasons[name] = monitor.reason
        return reasons

    def _check_predictions(
        self, rows: Iterable[NeighbourRow], known_uncooperative: Collection[str]
    ) -> tuple[str, ...]:
        """Return which neighbours do not fly as they predict, and mark those in the table.

        Neighbours in ``known_uncooperative`` are marked as well, whatever they predict.
        """
        wrong = []
        for row in rows:
            monitor = self._predictions[row.name]
            if row.is_cooperative and row.age_s < self._table.silent_s:
                vx, vy, _ = row.vector("velocity_enu_m_s")
                px, py, _ = row.vector("predicted_velocity_enu_m_s")
                monitor.update(row.stamp_ns, (vx, vy), (px, py), row.value("lead_time_s"))
            else:
                monitor.reset()

            if monitor.is_wrong:
                wrong.append(row.name)
            index = self._table.indices[row.name]
            is_not_cooperating = monitor.is_wrong or row.name in known_uncooperative
            self._table.judged.set_not_cooperating(index, is_not_cooperating)
        return tuple(wrong)

    def _check_distances(self, rows: Iterable[NeighbourRow], view: FlightView) -> tuple[str, ...]:
        """Return the neighbours to which even hard braking will not keep the safety distance."""
        if not self._flight.step.is_under_law or not view.has_position:
            return ()
        known = [row for row in rows if row.age_s < self._table.silent_s]
        return tuple(row.name for row in known if self._is_endangered(row, view))

    def _is_endangered(self, row: NeighbourRow, view: FlightView) -> bool:
        """Return whether the distance to a neighbour will be too small even if both brake."""
        x, y, z = view.position_enu_m
        vx, vy, vz = view.velocity_enu_m_s
        other_x, other_y, other_z = row.vector("position_enu_m")
        other_vx, other_vy, other_vz = row.vector("velocity_enu_m_s")

        apart_m = other_x - x, other_y - y
        if max(map(abs, apart_m)) >= _NEAR_M:
            return False

        above_it_m = z - other_z
        vertical_closing_m_s = (other_vz - vz) * math.copysign(1.0, above_it_m)
        height_left_m = abs(above_it_m) - _CLIMB_S * max(vertical_closing_m_s, 0.0)
        # A neighbour that does not cooperate may come down, for instance because it lands or falls.
        # Below such a neighbour, the horizontal distance counts at all heights.
        may_come_down_on_us = not row.is_cooperative and above_it_m < 0.0
        if height_left_m >= self._vertical_m and not may_come_down_on_us:
            return False

        braking_count = 2.0 if row.is_cooperative else 1.0  # number of vehicles that brake
        left_m = smallest_distance_m(
            apart_m,
            (vx - other_vx, vy - other_vy),
            reaction_s=self._vehicle.lag_s + row.age_s,
            deceleration_m_s2=self._braking_m_s2 * braking_count,
        )
        limit_m = self._limits.safety_distance_m
        # a neighbour within the limit counts as SEPARATION_BREACHED instead
        return left_m < limit_m - _PREDICTED_SLACK_M and math.hypot(*apart_m) > limit_m


def _blind(telemetries: Iterable[Telemetry], view: FlightView) -> tuple[str, ...]:
    """Return which neighbours use dead reckoning.

    Empty while this vehicle itself uses dead reckoning, because vehicles that have all lost their
    poses brake and sink together.
    """
    if view.is_dead_reckoned:
        return ()

    return tuple(
        telemetry.vehicle
        for telemetry in telemetries
        if telemetry.is_airborne and telemetry.state_age_s > NEIGHBOUR_BLIND_S
    )


def _too_windy_for(telemetries: Iterable[Telemetry]) -> tuple[str, ...]:
    """Return which neighbours report that the wind is above their limit or pushes them about."""
    return tuple(
        telemetry.vehicle
        for telemetry in telemetries
        if not _TOO_WINDY.isdisjoint(telemetry.conditions)
    )
