"""Messages between the vehicles: late, lost per link, and from senders that fall silent for a
while.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from onboard.arrays import Array, BoolArray, IntArray
from onboard.neighbours.table import SILENT_S
from onboard.rollout import batch
from onboard.rollout.rows import Rows
from sitl.monte_carlo.settings import Perturbation
from sitl.monte_carlo.vehicles import TICK_S

# poses of a silent vehicle come this long after its last message: SILENT_AFTER_S, and what it takes
# to ask for them
_TRACKED_AFTER_S = 0.16
_TRACKED_AGE_S = 0.04  # of its motion by them, as that of the own poses and of the way to the law
_MOST_SENDERS = 32  # in larger fleets only so many nearest are gathered; the law itself uses fewer


class Radio:
    """The newest message of every sender at every receiver; (F, receiver, sender, ...)."""

    def __init__(
        self,
        states: Rows,
        is_stranger: BoolArray,
        perturbation: Perturbation,
        lateness_s: float = 0.0,
    ) -> None:
        """Begin with a message of everybody.

        Args:
            is_stranger: (F, N) tracked, but of no fleet; never cooperative, and nobody knows its
                intentions.
            lateness_s: by which states are expected to be late, so that nobody counts as silent for
                it.
        """
        first = batch.message(states, None)
        flights, count = first.shape[:2]
        self._p, self._silent_s = perturbation, SILENT_S + lateness_s
        # what is published in a tick can be heard in the next one at the earliest
        self._late = max(1, math.ceil(round(perturbation.delay_s / TICK_S, 6)))
        self._sent: deque[Rows] = deque([first] * self._late, self._late)
        self._inbox = np.repeat(first[:, None], count, axis=1)
        self._age_s = np.full((flights, count, count), self._late * TICK_S)
        self._silence_s = np.zeros((flights, count))
        self._is_stranger = is_stranger
        self._others = self._heard = batch.all_others(count)

    def publish(self, states: Rows, ticks: Rows) -> None:
        """Send everybody's message of this tick."""
        self._sent.appendleft(batch.message(states, ticks))

    def receive(
        self, link_draws: Array, is_mute: BoolArray, is_frozen: BoolArray, tracked: Rows | None
    ) -> Rows:
        """Return the newest messages (F, N, K) that each vehicle has of the others.

        Args:
            link_draws: (F, N, N) uniform in [0, 1). is_mute: (F, N) sends nothing.
            is_frozen: (F, N) does not cooperate.
            tracked: (F, N) as the poses of the mocap say, which represent strangers and whoever is
                silent; None without a mocap.
        """
        p = self._p
        silent = is_mute
        if p.burst_s > 0.0:
            begins = np.einsum("fnn->fn", link_draws) < TICK_S / p.burst_every_s
            self._silence_s = np.where(
                begins & (self._silence_s <= 0.0), p.burst_s, self._silence_s - TICK_S
            )
            silent = silent | (self._silence_s > 0.0)
        arrived = (link_draws >= p.loss_share) & ~silent[:, None, :]
        np.copyto(self._inbox, self._sent[-1][:, None], where=arrived)
        self._age_s = np.where(arrived, self._late * TICK_S, self._age_s + TICK_S)
        is_cooperative = (self._age_s <= self._silent_s) & ~(self._is_stranger | is_frozen)[
            :, None, :
        ]
        self._heard = self._senders()
        inbox, age_s = self._inbox, self._age_s
        if tracked is not None:
            is_silent = age_s > self._late * TICK_S + _TRACKED_AFTER_S
            is_tracked = is_silent | self._is_stranger[:, None, :]
            if is_tracked.any():  # hardly ever: the inbox of a large fleet is long to copy
                inbox = np.where(is_tracked, tracked[:, None], inbox)
                age_s, is_cooperative = (
                    np.where(is_tracked, _TRACKED_AGE_S, age_s),
                    is_cooperative & ~is_tracked,
                )
        return batch.received(inbox, age_s, self._heard, is_cooperative)

    def vehicle(self, neighbour: IntArray) -> IntArray:
        """Places in the fleet (F, N) of places among the neighbours received last; -1 stays."""
        if not self._heard.shape[-1]:
            return np.full_like(neighbour, -1)
        senders = np.broadcast_to(self._heard, (*neighbour.shape, self._heard.shape[-1]))
        is_one = (neighbour >= 0) & (neighbour < senders.shape[-1])
        places = np.take_along_axis(senders, np.where(is_one, neighbour, 0)[..., None], axis=-1)[
            ..., 0
        ]
        return np.where(is_one, places, -1)

    def _senders(self) -> IntArray:
        count = self._inbox.shape[1]
        if count - 1 <= _MOST_SENDERS:
            return self._others
        position = self._inbox["position_enu_m"][..., :2]
        known = np.einsum("fiic->fic", position)
        gap = position - known[:, :, None]
        distance_2 = np.einsum("fijc,fijc->fij", gap, gap)
        distance_2[:, np.arange(count), np.arange(count)] = np.inf
        return np.sort(
            np.argpartition(distance_2, _MOST_SENDERS, axis=-1)[..., :_MOST_SENDERS], axis=-1
        )

    def keep(self, flights: IntArray) -> None:
        """Go on with these flights of the batch only."""
        self._sent = deque([message[flights] for message in self._sent], self._late)
        self._inbox, self._age_s = self._inbox[flights], self._age_s[flights]
        self._silence_s, self._is_stranger = self._silence_s[flights], self._is_stranger[flights]
