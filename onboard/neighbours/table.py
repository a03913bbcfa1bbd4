"""Newest state, telemetry and mocap poses of the other vehicles, on our own clock."""

from __future__ import annotations

import itertools
import math
import operator
from dataclasses import dataclass, field

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.bus.schema import MocapPose, StateMessage, Telemetry
from onboard.config.fleet import FleetConfig, Vec3
from onboard.config.pair_separation import separation_m
from onboard.message_counts import MessageCounts
from onboard.neighbours import subscription
from onboard.neighbours.judged import JudgedNeighbours, tracked_numbers
from onboard.neighbours.mocap_tracker import BodyTracker
from onboard.neighbours.plausibility import Claim, Seen
from onboard.neighbours.state_arrays import (
    AIRBORNE,
    ANNOUNCED,
    COLUMNS,
    KNOWN,
    NeighbourArrays,
    NeighbourRow,
    empty,
    is_plausible,
    is_usable,
    neighbours,
    numbers_of,
)
from onboard.neighbours.watched_bodies import SILENT_AFTER_S, WatchedBodies
from onboard.types import Neighbour

# more of both where [radio] expects states to come later
SILENT_S = 0.25  # with two ticks of confirmation a silence is acted on within 0.3 s
STALE_S = 0.15
_BELIEVED_S = 1.0
_ON_FLOOR_M = 0.15
_MISSING_AFTER_S = 2.0


@dataclass(slots=True)
class _Ages:
    """Ages of the newest states at one time, which several callers need at each tick.

    In lists: for the few neighbours of a drone a loop costs less than numpy's calls.
    """

    all_s: list[float]  # of each of K neighbours; inf when never heard
    followed_s: list[float] = field(default_factory=list)
    oldest_s: float = math.inf  # of those followed
    has_silent: bool = True
    at_ns: int = -1


class NeighbourTable:
    """The other vehicles of the fleet file in its order, so that indices never change.

    Whoever tells a state is an obstacle, also a vehicle that the file disables; only nobody waits
    for that one. A neighbour that is silent for a while is represented by its mocap poses instead,
    and does not cooperate.
    """

    def __init__(self, fleet: FleetConfig, own_name: str) -> None:
        self.fleet, self.own_name = fleet, own_name
        order = fleet.enabled_names
        self.names = tuple(name for name in fleet.vehicles if name != own_name)
        self.indices = {name: index for index, name in enumerate(self.names)}
        # index of each neighbour among all vehicles of the file
        self.fleet_indices: IntArray = np.array(
            [fleet.vehicles[name].index for name in self.names], dtype=np.int64
        )
        own = order.index(own_name) if own_name in order else 0
        successor = order[(own + 1) % len(order)] if order else ""
        self.is_successor: BoolArray = np.array(
            [name == successor for name in self.names], dtype=bool
        )
        self.watched = WatchedBodies(fleet.expected_radio.lateness_s)
        self.arrays: NeighbourArrays = empty(len(self.names), self.silent_s)
        self.counts = MessageCounts()
        self.last_heard_ns = 0  # of any message
        bodies = {index: fleet.vehicles[name].body for name, index in self.indices.items()}
        self.judged = JudgedNeighbours()
        self._bodies = {body: index for index, body in bodies.items() if body is not None}
        self._trackers: dict[int, BodyTracker] = {}
        self._telemetry: dict[str, Telemetry] = {}
        most = max(subscription.ALWAYS_FOLLOWED, int(fleet.law.max_neighbours))
        self._follow_limits = subscription.reach_m(fleet, own_name), most
        self._ages = _Ages([math.inf] * len(self.names))
        at_first = frozenset(self.names if len(self.names) <= subscription.ALWAYS_FOLLOWED else ())
        self._follow(at_first, at_first)

    # -- selection ---------------------------------------------------------------------------------

    @property
    def silent_s(self) -> float:
        """Age of its newest state from which on a neighbour that is followed counts as silent."""
        return SILENT_S + self.watched.late_s

    @property
    def followed(self) -> frozenset[str]:
        """Neighbours whose states are to be received at full rate; in a large fleet nobody at
        first.
        """
        return frozenset(self._followed)

    @property
    def _is_settled(self) -> BoolArray:
        """Return who (K,) is followed, and has been heard so since an earlier choice."""
        return np.asarray(self.arrays.silent_after_s <= self.silent_s)

    def select_followed(self, position_enu_m: Vec3, now_ns: int) -> bool:
        """Select anew the neighbours to follow; whether that changed anything."""
        if len(self.names) <= subscription.ALWAYS_FOLLOWED:
            return False
        ahead_s = np.minimum(self.ages_s(now_ns), subscription.FAR_SILENT_S)[:, None]
        ahead = self.arrays.numbers[:, :2] + ahead_s * self.arrays.numbers[:, 3:5]
        far_m = np.hypot(ahead[:, 0] - position_enu_m[0], ahead[:, 1] - position_enu_m[1]).tolist()
        is_known = self.arrays.flags[KNOWN].tolist()
        distances_m = {
            name: far for name, far, known in zip(self.names, far_m, is_known, strict=True) if known
        }
        before = self.followed
        selected = subscription.select(distances_m, before, *self._follow_limits)
        has_fast = self._is_settled | (np.array(self.ages_s(now_ns)) <= self.silent_s)
        settled = {
            name
            for name, has in zip(self.names, has_fast.tolist(), strict=True)
            if has and name in before
        }
        self._follow(selected, selected & settled)
        return selected != before

    def _follow(self, names: frozenset[str], settled: frozenset[str]) -> None:
        """Follow these; of those not settled yet the newest state is still one of the slow ones, or
        late.
        """
        self._followed = [name for name in self.names if name in names]
        self._followed_indices = [self.indices[name] for name in self._followed]
        arrays = self.arrays
        arrays.is_followed[:] = False
        arrays.is_followed[self._followed_indices] = True
        is_settled = [name in settled for name in self.names]
        arrays.silent_after_s[:] = np.where(
            is_settled, self.silent_s, subscription.FAR_SILENT_S + self.watched.late_s
        )
        self._silent_after_s = arrays.silent_after_s.tolist()
        self.set_ages(self._ages.all_s, -1, True)

    # -- input -------------------------------------------------------------------------------------

    def hear(self, message: StateMessage | Telemetry, received_ns: int) -> bool:
        """Take a message with its stamp on our clock; False if it is of a stranger, repeated, late
        or not finite.
        """
        index = self.indices.get(message.vehicle)
        if index is None:
            # of a second agent for this one others tell
            self.counts.refused += message.vehicle != self.own_name
            return False
        self.last_heard_ns = max(self.last_heard_ns, received_ns)
        if isinstance(message, Telemetry):
            if not is_plausible(message.position_enu_m, message.goal_position_enu_m):
                self.counts.malformed += 1
                return False
            self._telemetry[message.vehicle] = message
            return True
        arrays = self.arrays
        # nothing comes from the future
        numbers, stamp_ns = numbers_of(message), min(message.stamp_ns, received_ns)
        # repeated, out of order, or from before a restart; a false sequence number could exclude
        # all that comes after
        is_old, is_sound = stamp_ns <= arrays.newest_ns[index], is_usable(message, numbers)
        if is_old or not is_sound:
            self.counts.malformed += not is_sound
            self.counts.late += is_sound
            return False
        arrays.newest_ns[index] = stamp_ns
        arrays.is_lost[index] = not message.is_valid
        if not message.is_valid:
            # it knows no position: its last valid state ages, and it is avoided like a silent
            # vehicle
            return True
        arrays.heard_ns[index] = stamp_ns
        announces = message.is_cooperative
        flags = (
            message.is_airborne,
            announces and index not in self.judged.not_cooperating,
            announces,
        )
        arrays.set_state(index, stamp_ns, numbers, flags)
        self.watched.seen.discard(index)
        self.forget_ages()
        return True

    def hear_pose(self, pose: MocapPose, received_ns: int) -> bool:
        """Take a neighbour's mocap pose; it counts only while the neighbour is silent."""
        index = self._bodies.get(pose.body)
        if index is None:
            return False
        if index not in self.watched.reason_ns:
            self.hear_other_pose(pose, received_ns)
            return False
        arrays, tracker = self.arrays, self._trackers.setdefault(index, BodyTracker())
        silence_s = (received_ns - int(arrays.heard_ns[index])) * 1e-9
        if not tracker.stamp_ns and silence_s < _BELIEVED_S:
            x, y, z = arrays.numbers[index, COLUMNS["velocity_enu_m_s"]].tolist()
            tracker.velocity_enu_m_s = (x, y, z)
        if not tracker.hear(pose, received_ns):
            return False
        if silence_s < SILENT_AFTER_S + self.watched.late_s:
            return True
        floor_m = self.fleet.vehicles[self.names[index]].start_enu_m[2]
        is_airborne = tracker.position_enu_m[2] > floor_m + _ON_FLOOR_M
        stamp_ns = min(tracker.stamp_ns, received_ns)
        arrays.set_state(index, stamp_ns, tracked_numbers(tracker), (is_airborne, False, False))
        self.watched.seen.add(index)
        self.forget_ages()
        return True

    def hear_other_pose(self, pose: MocapPose, received_ns: int) -> None:
        """Take a mocap pose of any body, which its vehicle's word is compared with."""
        index = self._bodies.get(pose.body)
        if index is None or not pose.is_tracked or not is_plausible(pose.position_enu_m):
            return
        before = self.judged.seen.get(index)
        if pose.stamp_ns <= received_ns and (
            before is None or pose.position_enu_m != before.position_enu_m
        ):
            # the very same again is frozen
            self.judged.seen[index] = Seen(pose.stamp_ns, pose.position_enu_m)

    def place_contradicted(self, position_enu_m: Vec3, now_ns: int) -> None:
        """Put each contradicted neighbour where it says or where the mocap sees it: the nearer."""
        if self.judged.contradicted:
            self.judged.place(self.arrays, self._trackers, position_enu_m, now_ns)
            self.forget_ages()

    def bodies_to_watch(self, now_ns: int, own_age_s: float) -> tuple[str, ...] | None:
        """Return the mocap bodies whose poses are wanted from now on; None while they stay the
        same.

        They are those of vehicles that are silent, or doubtful and followed, until neither has been
        so for a while.
        """
        has_started, doubtful = self.watched.begin(now_ns), self.judged.watched
        self.ages_s(now_ns)
        is_late = (
            self._ages.has_silent or self._ages.oldest_s >= SILENT_AFTER_S + self.watched.late_s
        )
        if not is_late and not doubtful and not self.watched.reason_ns:
            return None
        ages_s, is_followed = self.heard_ages_s(now_ns).tolist(), self._is_settled.tolist()
        is_airborne = self.arrays.flags[AIRBORNE].tolist()
        is_expected = [
            has_started and self.fleet.vehicles[name].enabled is not False for name in self.names
        ]
        silent = [
            index
            for index in self._bodies.values()
            if self.watched.is_silent(
                index, ages_s[index], is_followed[index], is_expected[index], is_airborne[index]
            )
        ]
        in_reach = [index for index in doubtful if is_followed[index]]
        indices = self.watched.update(silent, in_reach, now_ns, own_age_s)
        if indices is None:
            return None
        for index in self._trackers.keys() - set(indices):
            del self._trackers[index]
        return tuple(body for body, index in self._bodies.items() if index in indices)

    def claim(self, name: str) -> tuple[Claim | None, Seen | None]:
        """Return what a neighbour says of itself, and where the mocap sees it; None where nothing
        is known.

        One that flies by satellites errs by more than it knows; its word and the mocap's are not
        compared.
        """
        index = self.indices[name]
        if not self.fleet.vehicles[name].mocap_required:
            return self.judged.claim(self.arrays, index), None
        tracker, seen = self._trackers.get(index), self.judged.seen.get(index)
        if tracker is not None and (seen is None or tracker.stamp_ns > seen.stamp_ns):
            seen = Seen(tracker.stamp_ns, tracker.position_enu_m)
        return self.judged.claim(self.arrays, index), seen

    # -- ages --------------------------------------------------------------------------------------

    def ages_s(self, now_ns: int) -> list[float]:
        """Return the age of each of K newest states; inf when never heard."""
        if self._ages.at_ns != now_ns:
            arrays = self.arrays
            ages_s = [
                max(now_ns - stamp_ns, 0) * 1e-9 if is_known else math.inf
                for stamp_ns, is_known in zip(
                    arrays.stamp_ns.tolist(), arrays.flags[KNOWN].tolist(), strict=True
                )
            ]
            has_silent = any(map(operator.gt, ages_s, self._silent_after_s))
            self.set_ages(ages_s, now_ns, has_silent)
        return self._ages.all_s

    def forget_ages(self) -> None:
        """Have the ages calculated anew, since newer states are in the arrays."""
        self._ages.at_ns = -1

    def set_ages(self, ages_s: list[float], now_ns: int, has_silent: bool) -> None:
        """Set the ages of K neighbours at a time, where they were calculated for many tables
        together.
        """
        followed_s = [ages_s[index] for index in self._followed_indices]
        self._ages = _Ages(ages_s, followed_s, max(followed_s, default=0.0), has_silent, now_ns)

    def followed_ages_s(self, now_ns: int) -> dict[str, float]:
        """Return the age of the newest state of each vehicle that is followed and was ever heard."""
        self.ages_s(now_ns)
        ages = zip(self._followed, self._ages.followed_s, strict=True)
        return {name: age_s for name, age_s in ages if age_s < math.inf}

    def age_s(self, name: str, now_ns: int) -> float:
        """Return the age of one newest state; inf when never heard."""
        return self.ages_s(now_ns)[self.indices[name]]

    def oldest_age_s(self, now_ns: int) -> float:
        """Return the largest age of all that are followed and were ever heard; 0 without any."""
        return max(self.followed_ages_s(now_ns).values(), default=0.0)

    def heard_ages_s(self, now_ns: int) -> Array:
        """Return the age (K,) of each newest message; it grows while only mocap poses come; inf
        when never heard.
        """
        if not self.watched.seen:
            return np.array(self.ages_s(now_ns))
        heard_ns = self.arrays.heard_ns
        return np.where(heard_ns > 0, np.maximum(now_ns - heard_ns, 0) * 1e-9, np.inf)

    # -- lists -------------------------------------------------------------------------------------

    def rows(self, now_ns: int) -> list[NeighbourRow]:
        """Return the state of each neighbour that is followed, including those never heard (age
        inf).
        """
        self.ages_s(now_ns)
        arrays, at = self.arrays, self._followed_indices
        announces = (arrays.flags[ANNOUNCED] & arrays.flags[KNOWN])[at].tolist()
        columns = self._followed, self._ages.followed_s, arrays.stamp_ns[at].tolist(), announces
        return [
            NeighbourRow(*row) for row in zip(*columns, arrays.numbers[at].tolist(), strict=True)
        ]

    def missing(self, now_ns: int) -> tuple[str, ...]:
        """Return vehicles that must be there (enabled = true) and are not heard."""
        names = self._named(self.heard_ages_s(now_ns) > _MISSING_AFTER_S)
        return tuple(name for name in names if self.fleet.vehicles[name].enabled is True)

    def silent(self, now_ns: int) -> tuple[str, ...]:
        """Return vehicles that were in the air when last heard and have been silent too long."""
        self.ages_s(now_ns)
        if not self._ages.has_silent and not self.watched.seen:
            return ()
        return self._named(
            self.arrays.flags[AIRBORNE] & (self.heard_ages_s(now_ns) > self.arrays.silent_after_s)
        )

    def unseen(self, now_ns: int) -> tuple[str, ...]:
        """Return silent vehicles without mocap poses: nobody knows where they are.

        Poses of one that was not followed are asked for only when it has fallen silent, and have
        their time to come.
        """
        far_s = subscription.FAR_UNSEEN_S + self.watched.late_s
        limit_s = np.where(self._is_settled, self.arrays.silent_after_s, far_s)
        is_old = (np.array(self.ages_s(now_ns)) > limit_s) & (self.heard_ages_s(now_ns) > limit_s)
        return self._named(self.arrays.flags[AIRBORNE] & is_old)

    def stale(self, now_ns: int) -> tuple[str, ...]:
        """Return vehicles in the air that are followed and whose messages are old, though not yet
        silent.
        """
        self.ages_s(now_ns)
        if self._ages.oldest_s <= STALE_S + self.watched.late_s and not self.watched.seen:
            return ()
        ages_s = self.heard_ages_s(now_ns)
        is_stale = (ages_s > STALE_S + self.watched.late_s) & (ages_s <= self.silent_s)
        return self._named(self.arrays.flags[AIRBORNE] & self.arrays.is_followed & is_stale)

    def invalid(self) -> tuple[str, ...]:
        """Return vehicles in the air whose newest message says that they know no position."""
        return self._named(self.arrays.is_lost & self.arrays.flags[AIRBORNE])

    def _named(self, is_meant: BoolArray) -> tuple[str, ...]:
        return tuple(itertools.compress(self.names, is_meant.tolist())) if is_meant.any() else ()

    def other_hashes(self, own_hash: str) -> dict[str, str]:
        """Return the configuration hashes that differ from ours."""
        hashes = {name: telemetry.config_hash for name, telemetry in self._telemetry.items()}
        return {
            name: config_hash for name, config_hash in hashes.items() if config_hash != own_hash
        }

    def telemetries(self) -> dict[str, Telemetry]:
        """Return the newest telemetry of all that sent one."""
        return {name: self._telemetry[name] for name in self.names if name in self._telemetry}

    def distances_m(self, position_enu_m: Vec3, now_ns: int) -> dict[str, float]:
        """Return the separation from each vehicle that is followed, extrapolated up to the silence
        limit.
        """
        share = self.fleet.fleet.height_share
        self.ages_s(now_ns)
        motions = self.arrays.numbers[:, :6].tolist()
        distances_m = {}
        for name, index, age_s in zip(
            self._followed, self._followed_indices, self._ages.followed_s, strict=True
        ):
            if age_s < math.inf:
                x, y, z, vx, vy, vz = motions[index]
                ahead_s = min(age_s, self.silent_s)
                there = x + ahead_s * vx, y + ahead_s * vy, z + ahead_s * vz
                distances_m[name] = separation_m(there, position_enu_m, share)
        return distances_m

    def snapshot(self, now_ns: int) -> list[Neighbour]:
        """Return the values for the law of all neighbours that were ever heard, as of one tick."""
        return neighbours(self.arrays, self.ages_s(now_ns), self.is_successor)
