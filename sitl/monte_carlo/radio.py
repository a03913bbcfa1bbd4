"""Messages between the vehicles: delayed, lost on single links, or not sent for a while."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.neighbours.table import SILENT_S
from onboard.neighbours.watched_bodies import OVERDUE_S
from onboard.rollout import batch
from onboard.rollout.rows import Rows
from sitl.monte_carlo.campaign_settings import SimulatedErrors
from sitl.monte_carlo.vehicles import TICK_S

_REQUEST_S = 0.04  # from the request for a vehicle's mocap poses to the first of them
_TRACKED_AFTER_S = OVERDUE_S + _REQUEST_S  # after a silence of this, a pose replaces a message
_TRACKED_AGE_S = 0.04  # age of a motion from mocap poses when the law uses it
_MAX_SENDERS = 32  # nearest senders that a receiver gathers; the law uses fewer


class Radio:
    """The newest message of every sender at every receiver; (F, receiver, sender, ...)."""

    def __init__(
        self,
        states: Rows,
        is_intruder: BoolArray,
        perturbation: SimulatedErrors,
        lateness_s: float = 0.0,
        *,
        radius_m: Array,
    ) -> None:
        """Begin with one message of each vehicle at every receiver.

        Args:
            states: states (F, N) of the vehicles.
            is_intruder: (F, N) whether a vehicle is not a member of the fleet. The mocap sees it,
                but it sends nothing and never cooperates.
            perturbation: delay, loss and silences.
            lateness_s: expected lateness of states, which is added to the times after which a
                vehicle is overdue, and counts as silent.
            radius_m: (F, N) radii of the circles around persons, 0 for a vehicle.
        """
        first = batch.message(states, None)
        flights, count = first.shape[:2]
        self._perturbation = perturbation
        self._silent_s = SILENT_S + lateness_s
        self._tracked_after_s = _TRACKED_AFTER_S + lateness_s
        self._is_intruder = is_intruder
        self._radius_m = radius_m
        self._has_people = bool(radius_m.any())

        # a message can be received in the tick after the one in which it is published, or later
        self._delay_ticks = max(1, math.ceil(round(perturbation.delay_s / TICK_S, 6)))
        self._sent: deque[Rows] = deque([first] * self._delay_ticks, self._delay_ticks)

        self._inbox = np.repeat(first[:, None], count, axis=1)
        self._age_s = np.full((flights, count, count), self._delay_ticks * TICK_S)
        self._silence_s = np.zeros((flights, count))  # remaining silence of each sender
        # (N, K) or (F, N, K): indexes of the senders that each receiver gathers
        self._all_others = batch.all_others(count)
        self._gathered = self._all_others

    def publish(self, states: Rows, ticks: Rows) -> None:
        """Send the messages of all vehicles of this tick."""
        self._sent.appendleft(batch.message(states, ticks))

    def receive(
        self, link_draws: Array, is_mute: BoolArray, is_frozen: BoolArray, tracked: Rows | None
    ) -> Rows:
        """Return the newest messages (F, N, K) that each vehicle has of the others.

        Args:
            link_draws: random numbers (F, N, N), uniform in [0, 1).
            is_mute: (F, N) whether a vehicle sends nothing.
            is_frozen: (F, N) whether a vehicle does not cooperate.
            tracked: vehicles (F, N) as mocap poses show them, which replace the messages of
                intruders and overdue vehicles; None without a mocap.
        """
        is_sending = ~self._silent_senders(link_draws, is_mute)
        has_arrived = (link_draws >= self._perturbation.loss_share) & is_sending[:, None, :]
        np.copyto(self._inbox, self._sent[-1][:, None], where=has_arrived)
        delay_s = self._delay_ticks * TICK_S
        self._age_s = np.where(has_arrived, delay_s, self._age_s + TICK_S)

        is_heard = self._age_s <= self._silent_s
        avoids_nobody = self._is_intruder | is_frozen
        is_cooperative = is_heard & ~avoids_nobody[:, None, :]

        self._gathered = self._senders()
        inbox = self._inbox
        age_s = self._age_s
        if tracked is not None:
            is_overdue = age_s > delay_s + self._tracked_after_s
            is_tracked = is_overdue | self._is_intruder[:, None, :]
            if is_tracked.any():  # rare; in all other ticks this saves slow copies of the inbox
                inbox = np.where(is_tracked, tracked[:, None], inbox)
                age_s = np.where(is_tracked, _TRACKED_AGE_S, age_s)
                is_cooperative = is_cooperative & ~is_tracked
        neighbours = batch.received(inbox, age_s, self._gathered, is_cooperative)
        if self._has_people:
            flight = np.arange(len(self._radius_m))[:, None, None]
            neighbours["radius_m"] = self._radius_m[flight, self._gathered]
        return neighbours

    def _silent_senders(self, link_draws: Array, is_mute: BoolArray) -> BoolArray:
        """Return which vehicles (F, N) send nothing in this tick: mute ones and random silences."""
        burst_s = self._perturbation.burst_s
        if burst_s <= 0.0:
            return is_mute

        own_draws = np.einsum("fnn->fn", link_draws)  # of the link to itself, which has no messages
        begins = own_draws < TICK_S / self._perturbation.burst_every_s
        begins_anew = begins & (self._silence_s <= 0.0)
        self._silence_s = np.where(begins_anew, burst_s, self._silence_s - TICK_S)
        return is_mute | (self._silence_s > 0.0)

    def vehicle(self, neighbour: IntArray) -> IntArray:
        """Return the indexes in the fleet (F, N) of neighbours of the last :meth:`receive`.

        Args:
            neighbour: indexes (F, N) among the received neighbours; -1 stays -1.
        """
        gathered = self._gathered.shape[-1]
        if not gathered:
            return np.full_like(neighbour, -1)

        senders = np.broadcast_to(self._gathered, (*neighbour.shape, gathered))  # (F, N, K)
        is_valid = (neighbour >= 0) & (neighbour < gathered)
        index = np.where(is_valid, neighbour, 0)[..., None]
        vehicle = np.take_along_axis(senders, index, axis=-1)[..., 0]
        return np.where(is_valid, vehicle, -1)

    def _senders(self) -> IntArray:
        """Return the senders that each receiver gathers: all, or the nearest of a large fleet."""
        count = self._inbox.shape[1]
        if count - 1 <= _MAX_SENDERS:
            return self._all_others

        position = self._inbox["position_enu_m"][..., :2]  # (F, receiver, sender, 2)
        own = np.einsum("fiic->fic", position)
        offset = position - own[:, :, None]
        distance_2 = np.einsum("fijc,fijc->fij", offset, offset)

        itself = np.arange(count)
        distance_2[:, itself, itself] = np.inf
        nearest = np.argpartition(distance_2, _MAX_SENDERS, axis=-1)[..., :_MAX_SENDERS]
        return np.sort(nearest, axis=-1)

    def keep(self, flights: IntArray) -> None:
        """Keep only these rows (flights), and drop the others."""
        self._sent = deque([message[flights] for message in self._sent], self._delay_ticks)
        self._inbox = self._inbox[flights]
        self._age_s = self._age_s[flights]
        self._silence_s = self._silence_s[flights]
        self._is_intruder = self._is_intruder[flights]
        self._radius_m = self._radius_m[flights]
