"""The newest states of the other vehicles, from their messages or from the mocap, on our clock.

Usually a neighbour is avoided at the position of its newest message. There are two exceptions:

    An overdue neighbour has sent no message for some periods. The poses of its body are requested,
    and soon its row holds its newest mocap pose. It counts as not cooperative. If its messages do
    not return, it becomes silent a little later, whatever its poses say, because silence is the age
    of its last message.

    For a contradicted neighbour, the nearer of its own and the mocap's position counts (judged.py).

A mocap pose of a neighbour's body that is where our own vehicle is does not count: the mocap has
confused the two bodies (own_body.py).

In a large fleet, a vehicle follows only the neighbours within reach, and receives their states at
full rate. From all others it receives the slow states (subscription.py). The age beyond which a
neighbour counts as silent depends on whether it is followed.
"""

from __future__ import annotations

import itertools
import math
import operator
from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace

from onboard.arrays import Array, BoolArray
from onboard.bus.schema import MocapPose, StateMessage, Telemetry
from onboard.config.fleet import FleetConfig
from onboard.config.ground import lowest_ground_in_fence_m
from onboard.config.pair_separation import separation_m
from onboard.message_counts import MessageCounts
from onboard.neighbours import subscription
from onboard.neighbours.judged import JudgedNeighbours, tracked_numbers
from onboard.neighbours.mocap_tracker import BodyTracker
from onboard.neighbours.own_body import OwnBody
from onboard.neighbours.plausibility import Claim, MocapPosition
from onboard.neighbours.slot_claims import SlotClaims
from onboard.neighbours.state_arrays import (
    AIRBORNE,
    ANNOUNCED,
    KNOWN,
    VECTOR_COLUMNS,
    NeighbourArrays,
    NeighbourRow,
    NeighbourSnapshot,
    empty,
    is_plausible,
    is_usable,
    numbers_of,
    snapshot,
)
from onboard.neighbours.watched_bodies import OVERDUE_S, WatchedBodies
from onboard.tuples import Xyz

# Ages beyond which a followed neighbour is silent or stale. Both are larger if [radio] in the fleet
# file expects later states.
SILENT_S = 0.25  # with two ticks of confirmation, the reaction comes within 0.3 s
STALE_S = 0.15

# a tracker starts with the velocity of the neighbour's last message, unless the message is older
# than this
_VELOCITY_KNOWN_S = 1.0
_ON_GROUND_M = 0.15  # a body less than this above the ground may stand there
# A take-off spot may be higher than the ground, for instance on a table. A body at its height may
# stand there if it is nearer than this, and slower than this.
_ON_SPOT_M = 1.0
_STANDS_M_S = 0.5
_MISSING_AFTER_S = 2.0  # a required vehicle is missing after this time without valid states
_LEFT_NS = 5_000_000_000  # an agent has ended after this time without telemetry
_START_UP_NS = 2_000_000_000  # an agent that has just started has not heard all others yet


@dataclass(slots=True)
class _Ages:
    """Ages of the newest states at one time. Several callers need them at each tick.

    They are lists, because for a few neighbours a loop is faster than numpy calls.
    """

    all_s: list[float]  # age of each of K neighbours; inf: never heard
    followed_s: list[float] = field(default_factory=list)  # ages of the followed neighbours
    oldest_s: float = math.inf  # largest age of a followed neighbour
    has_silent: bool = True  # whether some neighbour is silent
    at_ns: int = -1  # time of these ages; -1: they are outdated


class NeighbourTable:
    """The other vehicles of the fleet file, in its order, so that their indices never change.

    A vehicle that publishes a state is avoided, even if the file disables it. But an absent vehicle
    is not reported as missing if the file disables it.
    """

    def __init__(self, fleet: FleetConfig, own_name: str) -> None:
        self.fleet = fleet
        self.own_name = own_name
        self.names = tuple(name for name in fleet.vehicles if name != own_name)
        self.indices = {name: index for index, name in enumerate(self.names)}
        # in the order of the law's indices: these vehicles, then the persons (people.py)
        self.avoided_names = (*self.names, *fleet.people)

        self.watched_bodies = WatchedBodies(fleet.expected_radio.lateness_s)
        self.silent_s = SILENT_S + self.watched_bodies.late_s  # limit for followed neighbours
        self._stale_s = STALE_S + self.watched_bodies.late_s
        self._height_share = fleet.fleet.height_share
        self.lowest_ground_m = lowest_ground_in_fence_m(fleet)

        is_successor = _is_successor(fleet, own_name, self.names)
        self.arrays: NeighbourArrays = empty(is_successor, self.silent_s)
        self.judged = JudgedNeighbours()
        self.counts = MessageCounts()
        self.last_heard_ns = 0  # arrival of the newest message of any neighbour

        self._bodies: dict[str, int] = {}  # mocap body -> index
        for name, index in self.indices.items():
            body = fleet.vehicles[name].body
            if body is not None:
                self._bodies[body] = index
        self._trackers: dict[int, BodyTracker] = {}  # index -> tracker of a watched body
        self._own_body = OwnBody(
            body_diameter_m=fleet.fleet.body_diameter_m,
            separation_m=fleet.fleet.safety_distance_m,
        )
        self._telemetry: dict[str, Telemetry] = {}
        self._slots = SlotClaims(own_name, self._is_gone)
        self._started_ns = 0  # time of the first tick; 0 before it

        self._reach_m = subscription.reach_m(fleet, own_name)
        self._most_followed = max(subscription.ALWAYS_FOLLOWED, int(fleet.law.max_neighbours))
        self._ages = _Ages([math.inf] * len(self.names))
        at_first: frozenset[str] = frozenset()
        if len(self.names) <= subscription.ALWAYS_FOLLOWED:
            at_first = frozenset(self.names)
        self._follow(at_first, at_first)

    # -- selection ---------------------------------------------------------------------------------

    @property
    def followed(self) -> frozenset[str]:
        """Neighbours whose states are received at full rate; in a large fleet none at first."""
        return frozenset(self._followed)

    @property
    def names_to_check(self) -> list[str]:
        """Followed neighbours, and others that are still watched or contradicted, in file order."""
        suspects = self.judged.watched | self.judged.contradicted
        return [
            name
            for name, index in self.indices.items()
            if self.arrays.is_followed[index] or index in suspects
        ]

    @property
    def _is_settled(self) -> BoolArray:
        """Whether each neighbour (K,) is settled: it is followed, and its fast states already
        arrive.

        Only settled neighbours have the short limit of silence (see :meth:`_follow`).
        """
        return np.asarray(self.arrays.silent_after_s <= self.silent_s)

    def select_followed(self, position_enu_m: Xyz, now_ns: int) -> bool:
        """Select the neighbours to follow again; return whether the selection changed."""
        if len(self.names) <= subscription.ALWAYS_FOLLOWED:
            return False

        # horizontal positions, extrapolated from the newest states to now
        ages_s = self.ages_s(now_ns)
        ahead_s = np.minimum(ages_s, subscription.FAR_SILENT_S)[:, None]
        position_m = self.arrays.numbers[:, :2]
        velocity_m_s = self.arrays.numbers[:, 3:5]
        now_m = position_m + ahead_s * velocity_m_s

        x_m, y_m, _ = position_enu_m
        all_distances_m = np.hypot(now_m[:, 0] - x_m, now_m[:, 1] - y_m).tolist()
        distances_m = {}
        is_known = self.arrays.flags[KNOWN].tolist()
        for name, distance_m, known in zip(self.names, all_distances_m, is_known, strict=True):
            if known:
                distances_m[name] = distance_m

        before = self.followed
        selected = subscription.select(distances_m, before, self._reach_m, self._most_followed)

        # settled: already followed, and fast states already arrive
        settled = set()
        sends_fast = self._is_settled | (np.array(ages_s) <= self.silent_s)
        for name, is_fast in zip(self.names, sends_fast.tolist(), strict=True):
            if is_fast and name in before:
                settled.add(name)

        self._follow(selected, selected & settled)
        return selected != before

    def _follow(self, names: frozenset[str], settled: frozenset[str]) -> None:
        """Follow these neighbours from now on.

        Args:
            names: neighbours to follow.
            settled: those of them whose fast states already arrive. The newest state of the others
                is still a slow one.
        """
        self._followed = [name for name in self.names if name in names]
        self._followed_indices = [self.indices[name] for name in self._followed]

        arrays = self.arrays
        arrays.is_followed[:] = False
        arrays.is_followed[self._followed_indices] = True

        is_settled = [name in settled for name in self.names]
        far_silent_s = subscription.FAR_SILENT_S + self.watched_bodies.late_s
        arrays.silent_after_s[:] = np.where(is_settled, self.silent_s, far_silent_s)
        self._silent_after_s = arrays.silent_after_s.tolist()
        self._ages.at_ns = -1
        self._ages.has_silent = True

    # -- input -------------------------------------------------------------------------------------

    def hear(self, message: StateMessage | Telemetry, received_ns: int) -> bool:
        """Take a message with its stamp on our clock; return whether it was used.

        Messages of unknown vehicles are not used. Messages that are repeated, late or not finite
        are not used either.
        """
        index = self.indices.get(message.vehicle)
        if index is None:
            # a message under our own name comes from a second agent; the others report it
            if message.vehicle != self.own_name:
                self.counts.refused += 1
            return False

        self.last_heard_ns = max(self.last_heard_ns, received_ns)
        if isinstance(message, Telemetry):
            return self._hear_telemetry(message, received_ns)
        return self._hear_state(index, message, received_ns)

    def _hear_telemetry(self, message: Telemetry, received_ns: int) -> bool:
        """Keep a telemetry message; return whether it was used."""
        are_positions_plausible = is_plausible(message.position_enu_m, message.goal_position_enu_m)
        if not are_positions_plausible or math.isnan(message.state_age_s):
            self.counts.malformed += 1
            return False

        # as for a state, a false stamp could exclude all later messages
        if message.stamp_ns > received_ns:
            message = replace(message, stamp_ns=received_ns)
        before = self._telemetry.get(message.vehicle)
        if before is not None and message.stamp_ns <= before.stamp_ns:
            self.counts.late += 1
            return False

        self._telemetry[message.vehicle] = message
        self._slots.note(message)
        return True

    def _hear_state(self, index: int, message: StateMessage, received_ns: int) -> bool:
        numbers = numbers_of(message)
        if not is_usable(message, numbers):
            self.counts.malformed += 1
            return False

        # The stamp decides whether a state is repeated, out of order, or from before a restart. The
        # sequence number is not used, because a false number could exclude all later messages. A
        # false stamp cannot, because it is limited to now.
        arrays = self.arrays
        stamp_ns = min(message.stamp_ns, received_ns)
        if stamp_ns <= arrays.newest_ns[index]:
            self.counts.late += 1
            return False

        arrays.newest_ns[index] = stamp_ns
        arrays.is_lost[index] = not message.is_valid
        if not message.is_valid:
            # The sender does not know its position. Its last valid state ages, so it is avoided
            # like a silent vehicle.
            return True

        announces = message.is_cooperative
        arrays.heard_ns[index] = stamp_ns
        arrays.set_state(
            index,
            stamp_ns,
            numbers,
            is_airborne=message.is_airborne,
            is_cooperative=announces and index not in self.judged.not_cooperating,
            announces=announces,
        )
        self.watched_bodies.located.discard(index)
        self._forget_ages()
        return True

    def hear_pose(self, pose: MocapPose, received_ns: int) -> bool:
        """Take a neighbour's mocap pose. Return whether its body is watched and the pose is usable.

        The pose becomes the neighbour's state only while the neighbour is overdue.
        """
        index = self._bodies.get(pose.body)
        if index is None or self._is_own_body(index, pose, received_ns):
            return False
        if index not in self.watched_bodies.reason_ns:
            self.note_mocap_position(pose, received_ns)
            return False

        arrays = self.arrays
        tracker = self._trackers.setdefault(index, BodyTracker())
        silence_s = (received_ns - int(arrays.heard_ns[index])) * 1e-9
        if not tracker.stamp_ns and silence_s < _VELOCITY_KNOWN_S:
            vx, vy, vz = arrays.numbers[index, VECTOR_COLUMNS["velocity_enu_m_s"]].tolist()
            tracker.velocity_enu_m_s = (vx, vy, vz)
            tracker.has_velocity = True
        if not tracker.hear(pose, received_ns):
            return False
        if silence_s < OVERDUE_S + self.watched_bodies.late_s:
            return True

        is_airborne = not self._may_stand(tracker)
        stamp_ns = min(tracker.stamp_ns, received_ns)
        arrays.set_state(index, stamp_ns, tracked_numbers(tracker), is_airborne=is_airborne)
        self.watched_bodies.located.add(index)
        self._forget_ages()
        return True

    def _may_stand(self, tracker: BodyTracker) -> bool:
        """Return whether a body may stand on the ground, or on any vehicle's take-off spot."""
        x, y, height_m = tracker.position_enu_m
        if height_m <= self.lowest_ground_m + _ON_GROUND_M:
            return True
        if math.hypot(*tracker.velocity_enu_m_s) > _STANDS_M_S:
            return False

        for vehicle in self.fleet.vehicles.values():
            start_x, start_y, start_m = vehicle.start_enu_m
            is_near = math.hypot(x - start_x, y - start_y) <= _ON_SPOT_M
            if is_near and abs(height_m - start_m) <= _ON_GROUND_M:
                return True
        return False

    def note_mocap_position(self, pose: MocapPose, received_ns: int) -> None:
        """Note where the mocap sees a body, to compare its vehicle's messages with it."""
        index = self._bodies.get(pose.body)
        if index is None or not pose.is_tracked or not is_plausible(pose.position_enu_m):
            return
        if self._is_own_body(index, pose, received_ns):
            return

        # an exact repetition means that the mocap has lost the body
        before = self.judged.mocap_positions.get(index)
        is_frozen = before is not None and pose.position_enu_m == before.position_enu_m
        if pose.stamp_ns <= received_ns and not is_frozen:
            self.judged.mocap_positions[index] = MocapPosition(pose.stamp_ns, pose.position_enu_m)

    def _is_own_body(self, index: int, pose: MocapPose, received_ns: int) -> bool:
        """Return whether a pose of a neighbour's body is a pose of our own body."""
        expected_enu_m = None
        if self.arrays.flags[KNOWN, index]:
            x, y, z, vx, vy, vz = self.arrays.numbers[index, :6].tolist()
            age_s = max(received_ns - int(self.arrays.stamp_ns[index]), 0) * 1e-9
            ahead_s = min(age_s, self.silent_s)
            expected_enu_m = (x + ahead_s * vx, y + ahead_s * vy, z + ahead_s * vz)
        return self._own_body.is_seen_in(index, pose.position_enu_m, expected_enu_m)

    def replaced(self, own_slot_owner: str, now_ns: int) -> frozenset[str]:
        """Return the other vehicles whose slot our own vehicle or a neighbour has.

        Args:
            own_slot_owner: vehicle whose start and slots our own vehicle uses; usually itself.
            now_ns: present time.
        """
        return self._slots.replaced(own_slot_owner, now_ns)

    def _is_gone(self, name: str, now_ns: int) -> bool:
        """Whether a neighbour that was on the ground when last heard has been silent for long."""
        telemetry = self._telemetry.get(name)
        if telemetry is None:
            return True
        silent_s = (now_ns - telemetry.stamp_ns) * 1e-9
        return not telemetry.is_airborne and silent_s > _MISSING_AFTER_S

    def forget_replaced(self, own_slot_owner: str, now_ns: int) -> None:
        """Forget where replaced vehicles stood, unless they still publish a position.

        In a swap, a person carries the replaced vehicle away, and its stand-in stands on its spot.
        So a replaced vehicle that is silent, or does not know its position, must not be avoided at
        its last position.

        Args:
            own_slot_owner: vehicle whose start and slots our own vehicle uses; usually itself.
            now_ns: present time.
        """
        arrays = self.arrays
        for name in self.replaced(own_slot_owner, now_ns):
            index = self.indices.get(name)
            if index is None or arrays.flags[AIRBORNE, index]:
                continue
            if arrays.is_lost[index] or self.age_s(name, now_ns) > arrays.silent_after_s[index]:
                arrays.flags[KNOWN, index] = False
                self._telemetry.pop(name, None)
                self._forget_ages()

    # -- silent and contradicted neighbours --------------------------------------------------------

    def note_own_position(self, position_enu_m: Xyz | None) -> None:
        """Note where our own vehicle is at this tick; None: not known."""
        self._own_body.position_enu_m = position_enu_m

    def reposition_contradicted(self, position_enu_m: Xyz, now_ns: int) -> None:
        """Put each contradicted neighbour at its nearer position, and keep the other one."""
        if self.judged.contradicted:
            self.judged.write_positions(
                self.arrays,
                self._trackers,
                position_enu_m,
                now_ns,
                overdue_s=OVERDUE_S + self.watched_bodies.late_s,
            )
            self._forget_ages()

    def claim(self, name: str) -> tuple[Claim | None, MocapPosition | None]:
        """Return a neighbour's motion from its messages, and its mocap position; None: not known.

        The mocap position is None for a neighbour that uses satellite positioning. Its messages may
        err by more than they say, so they are not compared with the mocap.
        """
        index = self.indices[name]
        claim = self.judged.claim(self.arrays, index)
        if not self.fleet.vehicles[name].mocap_required:
            return claim, None

        mocap_position = self.judged.mocap_positions.get(index)
        tracker = self._trackers.get(index)
        if tracker is None:
            return claim, mocap_position
        if mocap_position is None or tracker.stamp_ns > mocap_position.stamp_ns:
            mocap_position = MocapPosition(tracker.stamp_ns, tracker.position_enu_m)
        return claim, mocap_position

    def bodies_to_watch(self, now_ns: int, own_age_s: float) -> tuple[str, ...] | None:
        """Return the mocap bodies whose poses are needed from now on; None: the same as before.

        These are the bodies of vehicles that are overdue, or watched and within reach, now or in
        the last seconds.

        Args:
            now_ns: our clock.
            own_age_s: age of our own position.
        """
        if not self._started_ns:
            self._started_ns = now_ns

        self.ages_s(now_ns)
        overdue_s = OVERDUE_S + self.watched_bodies.late_s
        has_overdue = self._ages.has_silent or self._ages.oldest_s >= overdue_s
        if not has_overdue and not self.judged.watched and not self.watched_bodies.reason_ns:
            return None

        is_settled = self._is_settled.tolist()
        overdue = self._overdue(now_ns, is_settled)
        in_reach = [index for index in self.judged.watched if is_settled[index]]
        indices = self.watched_bodies.update(overdue, in_reach, now_ns, own_age_s)
        if indices is None:
            return None

        for index in self._trackers.keys() - set(indices):
            del self._trackers[index]
        return tuple(body for body, index in self._bodies.items() if index in indices)

    def _overdue(self, now_ns: int, is_settled: list[bool]) -> list[int]:
        """Return the indices of the vehicles with a body that are overdue."""
        ages_s = self.heard_ages_s(now_ns).tolist()
        is_airborne = self.arrays.flags[AIRBORNE].tolist()
        has_started_up = now_ns - self._started_ns > _START_UP_NS

        overdue = []
        for index in self._bodies.values():
            is_enabled = self.fleet.vehicles[self.names[index]].enabled is not False
            if self.watched_bodies.is_overdue(
                index,
                age_s=ages_s[index],
                is_followed=is_settled[index],
                is_expected=has_started_up and is_enabled,
                is_airborne=is_airborne[index],
            ):
                overdue.append(index)
        return overdue

    # -- ages --------------------------------------------------------------------------------------

    def ages_s(self, now_ns: int) -> list[float]:
        """Return the age [s] of each of K newest states; inf: never heard."""
        if self._ages.at_ns == now_ns:
            return self._ages.all_s

        ages_s = []
        stamps_ns = self.arrays.stamp_ns.tolist()
        is_known = self.arrays.flags[KNOWN].tolist()
        for stamp_ns, known in zip(stamps_ns, is_known, strict=True):
            age_s = math.inf
            if known:
                age_s = max(now_ns - stamp_ns, 0) * 1e-9
            ages_s.append(age_s)

        followed_s = [ages_s[index] for index in self._followed_indices]
        self._ages = _Ages(
            all_s=ages_s,
            followed_s=followed_s,
            oldest_s=max(followed_s, default=0.0),
            has_silent=any(map(operator.gt, ages_s, self._silent_after_s)),
            at_ns=now_ns,
        )
        return ages_s

    def _forget_ages(self) -> None:
        """Mark the ages as outdated, because a newer state is in the arrays."""
        self._ages.at_ns = -1

    def followed_ages_s(self, now_ns: int) -> dict[str, float]:
        """Return the age of the newest state of each vehicle that is followed and known."""
        self.ages_s(now_ns)
        ages = zip(self._followed, self._ages.followed_s, strict=True)
        return {name: age_s for name, age_s in ages if age_s < math.inf}

    def age_s(self, name: str, now_ns: int) -> float:
        """Return the age of a neighbour's newest state; inf: never heard."""
        return self.ages_s(now_ns)[self.indices[name]]

    def oldest_age_s(self, now_ns: int) -> float:
        """Return the largest age [s] of the followed and known neighbours; 0 if there are none."""
        return max(self.followed_ages_s(now_ns).values(), default=0.0)

    def heard_ages_s(self, now_ns: int) -> Array:
        """Return the age (K,) [s] of each newest message; inf: never heard.

        Mocap poses do not count as messages.
        """
        if not self.watched_bodies.located:
            return np.array(self.ages_s(now_ns))
        heard_ns = self.arrays.heard_ns
        return np.where(heard_ns > 0, np.maximum(now_ns - heard_ns, 0) * 1e-9, np.inf)

    # -- what is known at one time -----------------------------------------------------------------

    def snapshot(self, now_ns: int) -> NeighbourSnapshot:
        """Return all known neighbours at one tick, in the form that the law takes.

        A contradicted neighbour with two positions has a second entry after all others.
        """
        neighbours = snapshot(self.arrays, self.ages_s(now_ns))
        if not self.judged.contradicted:
            return neighbours
        return self.judged.added_to(neighbours, self.arrays, now_ns)

    def distances_m(self, position_enu_m: Xyz, now_ns: int) -> dict[str, float]:
        """Return the separation [m] from each followed and known neighbour.

        A neighbour's position is extrapolated for at most the age beyond which it counts as silent.
        """
        self.ages_s(now_ns)
        motions = self.arrays.numbers[self._followed_indices, :6].tolist()

        distances_m = {}
        followed = zip(self._followed, motions, self._ages.followed_s, strict=True)
        for name, motion, age_s in followed:
            if age_s < math.inf:
                x, y, z, vx, vy, vz = motion
                ahead_s = min(age_s, self.silent_s)
                now_enu_m = (x + ahead_s * vx, y + ahead_s * vy, z + ahead_s * vz)
                distances_m[name] = separation_m(now_enu_m, position_enu_m, self._height_share)
        return distances_m

    def rows(self, now_ns: int) -> list[NeighbourRow]:
        """Return the state of each followed neighbour; its age is inf if it was never heard."""
        self.ages_s(now_ns)
        arrays = self.arrays
        indices = self._followed_indices
        announces = arrays.flags[ANNOUNCED] & arrays.flags[KNOWN]

        columns = (
            self._followed,
            self._ages.followed_s,
            arrays.stamp_ns[indices].tolist(),
            announces[indices].tolist(),
            arrays.numbers[indices].tolist(),
        )
        return [NeighbourRow(*row) for row in zip(*columns, strict=True)]

    def telemetries(self) -> dict[str, Telemetry]:
        """Return each neighbour's newest telemetry, by name, in the order of the fleet file.

        A silent vehicle that the mocap sees, perhaps because it was carried away, has the position
        at which it is seen.
        """
        telemetries = {}
        for name, index in self.indices.items():
            telemetry = self._telemetry.get(name)
            if telemetry is None:
                continue
            if index in self.watched_bodies.located:
                x, y, z = self.arrays.numbers[index, :3].tolist()
                telemetry = replace(telemetry, position_enu_m=(x, y, z))
            telemetries[name] = telemetry
        return telemetries

    def last_positions_enu_m(self) -> dict[str, Xyz]:
        """Return where each known neighbour was by its newest valid state [m], however old."""
        positions = {}
        for name, index in self.indices.items():
            if self.arrays.flags[KNOWN, index]:
                x, y, z = self.arrays.numbers[index, :3].tolist()
                positions[name] = (x, y, z)
        return positions

    def other_hashes(self, own_hash: str, now_ns: int) -> dict[str, str]:
        """Return the configuration hashes that differ from ours.

        A vehicle on the ground whose agent has ended no longer takes part, so its file is ignored.
        """
        hashes = {}
        for name, telemetry in self._telemetry.items():
            has_left = now_ns - telemetry.stamp_ns > _LEFT_NS
            is_airborne = self.arrays.flags[AIRBORNE, self.indices[name]]
            if has_left and not is_airborne:
                continue
            if telemetry.config_hash != own_hash:
                hashes[name] = telemetry.config_hash
        return hashes

    # -- neighbours with a problem -----------------------------------------------------------------

    def missing(self, now_ns: int) -> tuple[str, ...]:
        """Return vehicles that are required (enabled = true) but send no valid states."""
        names = self._named(self.heard_ages_s(now_ns) > _MISSING_AFTER_S)
        return tuple(name for name in names if self.fleet.vehicles[name].enabled is True)

    def without_position(self, now_ns: int) -> tuple[str, ...]:
        """Return vehicles that send states, but say in them that their position is not known."""
        arrays = self.arrays
        is_heard = (now_ns - arrays.newest_ns) * 1e-9 <= _MISSING_AFTER_S
        return self._named(arrays.is_lost & is_heard)

    def silent(self, now_ns: int) -> tuple[str, ...]:
        """Return vehicles that were in the air when last heard, and have been silent for too
        long.
        """
        self.ages_s(now_ns)
        if not self._ages.has_silent and not self.watched_bodies.located:
            return ()
        is_old = self.heard_ages_s(now_ns) > self.arrays.silent_after_s
        return self._named(self.arrays.flags[AIRBORNE] & is_old)

    def unseen(self, now_ns: int) -> tuple[str, ...]:
        """Return silent vehicles without mocap poses. Their position is not known.

        The poses of a vehicle that was not followed are requested only once it is silent. So it
        gets more time before it counts as unseen.
        """
        far_s = subscription.FAR_UNSEEN_S + self.watched_bodies.late_s
        limit_s = np.where(self._is_settled, self.arrays.silent_after_s, far_s)
        has_old_state = np.array(self.ages_s(now_ns)) > limit_s
        has_old_message = self.heard_ages_s(now_ns) > limit_s
        return self._named(self.arrays.flags[AIRBORNE] & has_old_state & has_old_message)

    def stale(self, now_ns: int) -> tuple[str, ...]:
        """Return followed vehicles in the air that are late, but not yet silent."""
        self.ages_s(now_ns)
        if self._ages.oldest_s <= self._stale_s and not self.watched_bodies.located:
            return ()
        ages_s = self.heard_ages_s(now_ns)
        is_stale = (ages_s > self._stale_s) & (ages_s <= self.silent_s)
        return self._named(self.arrays.flags[AIRBORNE] & self.arrays.is_followed & is_stale)

    def invalid(self) -> tuple[str, ...]:
        """Return vehicles in the air whose newest message says that their position is not known."""
        return self._named(self.arrays.is_lost & self.arrays.flags[AIRBORNE])

    def _named(self, mask: BoolArray) -> tuple[str, ...]:
        """Return the names of the neighbours that a mask (K,) selects."""
        if not mask.any():
            return ()
        return tuple(itertools.compress(self.names, mask.tolist()))


def _is_successor(fleet: FleetConfig, own_name: str, names: tuple[str, ...]) -> BoolArray:
    """Return whether each neighbour (K,) is the paper's obstacle: the next one in the ring."""
    ring = fleet.enabled_names
    successor = ""
    if ring:
        own_index = 0
        if own_name in ring:
            own_index = ring.index(own_name)
        successor = ring[(own_index + 1) % len(ring)]
    return np.array([name == successor for name in names], dtype=bool)
