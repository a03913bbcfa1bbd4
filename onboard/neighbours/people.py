"""Persons with markers in the motion capture, as neighbours that do not avoid others. Pure.

A person sends no messages. The law avoids the mocap motion of the person's body like a vehicle that
does not cooperate, with two differences:

    The distance is measured from a circle around the person (``radius_m``) that contains arms and
    legs.

    A person counts as being as tall as the fence, so that no vehicle flies over a person, even if
    the fleet file allows vehicles to fly above each other.

A person whose poses have stopped is unseen, and is avoided at the last known position. After a
longer time, the person counts as gone. Perhaps the person has left the room or taken the markers
off.
"""

from __future__ import annotations

import math

import numpy as np

from onboard.arrays import Array
from onboard.bus.schema import MocapPose
from onboard.config.fleet import FleetConfig
from onboard.neighbours.judged import tracked_numbers
from onboard.neighbours.mocap_tracker import BodyTracker
from onboard.neighbours.state_arrays import (
    KNOWN,
    SCALAR_COLUMN,
    NeighbourSnapshot,
    empty,
)
from onboard.tuples import Xyz

UNSEEN_S = 0.25  # a person whose newest pose is older is unseen
GONE_S = 10.0  # a person whose newest pose is older is gone

# columns in a row
_HEIGHT = 2
_VERTICAL_VELOCITY = 5


class People:
    """The persons of the fleet file, in its order.

    Args:
        fleet: the fleet file.
        first_index: index of the first person for the law: the number of vehicles in the table of
            the neighbours.
    """

    def __init__(self, fleet: FleetConfig, first_index: int) -> None:
        self.names = tuple(fleet.people)
        self.bodies = tuple(fleet.people_bodies.values())
        self._indices = {body: index for index, body in enumerate(self.bodies)}
        self._radii_m = [person.radius_m for person in fleet.people.values()]
        _, self._top_m = fleet.fleet.geofence_m.z
        self._late_s = fleet.expected_radio.lateness_s
        self._trackers = [BodyTracker() for _ in self.names]

        is_paper_obstacle = np.zeros(len(self.names), dtype=bool)  # no person is
        self._arrays = empty(is_paper_obstacle, UNSEEN_S)
        self._arrays.numbers[:, SCALAR_COLUMN["table_index"]] += first_index
        self._arrays.numbers[:, SCALAR_COLUMN["radius_m"]] = self._radii_m

    def hear_pose(self, pose: MocapPose, received_ns: int) -> bool:
        """Take a pose of any body. Return whether the body is a person's and the pose is usable."""
        index = self._indices.get(pose.body)
        if index is None:
            return False

        tracker = self._trackers[index]
        if not tracker.hear(pose, received_ns):
            return False

        numbers = list(tracked_numbers(tracker))
        numbers[_HEIGHT] = self._top_m
        numbers[_VERTICAL_VELOCITY] = 0.0
        stamp_ns = min(tracker.stamp_ns, received_ns)
        self._arrays.set_state(index, stamp_ns, tuple(numbers), is_airborne=True)
        return True

    def added_to(self, vehicles: NeighbourSnapshot, now_ns: int) -> NeighbourSnapshot:
        """Return the neighbours of one tick with the persons added after the vehicles."""
        is_here = self._is_here(now_ns)
        if not is_here.any():
            return vehicles

        rows = self._arrays.numbers[is_here].copy()
        rows[:, SCALAR_COLUMN["age_s"]] = self._ages_s(now_ns)[is_here]
        return NeighbourSnapshot(np.vstack([vehicles.rows, rows]))

    def distances_m(self, position_enu_m: Xyz, now_ns: int) -> dict[str, float]:
        """Return the horizontal distance [m] from a position to the circle of each person.

        A person's position is extrapolated for at most UNSEEN_S.
        """
        x, y, _ = position_enu_m
        ages_s = self._ages_s(now_ns).tolist()
        is_here = self._is_here(now_ns).tolist()
        rows = self._arrays.numbers[:, :6].tolist()

        distances_m = {}
        for index, name in enumerate(self.names):
            if is_here[index]:
                ahead_s = min(ages_s[index], UNSEEN_S)
                east_m, north_m, _, east_m_s, north_m_s, _ = rows[index]
                to_east_m = east_m + ahead_s * east_m_s - x
                to_north_m = north_m + ahead_s * north_m_s - y
                distances_m[name] = math.hypot(to_east_m, to_north_m) - self._radii_m[index]
        return distances_m

    def unseen(self, now_ns: int) -> tuple[str, ...]:
        """Return the persons whose poses have stopped but who are not gone yet."""
        is_unseen = self._is_here(now_ns) & (self._ages_s(now_ns) > UNSEEN_S + self._late_s)
        return tuple(self.names[index] for index in np.flatnonzero(is_unseen))

    def _ages_s(self, now_ns: int) -> Array:
        """Return the age (P,) [s] of each person's newest pose."""
        return np.asarray(np.maximum(now_ns - self._arrays.stamp_ns, 0) * 1e-9)

    def _is_here(self, now_ns: int) -> np.ndarray:
        """Return whether each person (P,) has been seen and is not gone."""
        return np.asarray(self._arrays.flags[KNOWN] & (self._ages_s(now_ns) <= GONE_S))
