"""Messages between the vehicles of many simulated flights, with delay and losses."""

from __future__ import annotations

from collections import deque

import numpy as np

from onboard.arrays import Array, BoolArray
from onboard.rollout import batch
from onboard.rollout.rows import Rows, floats
from onboard.rollout.vehicle_model import Perturbation
from onboard.types import TICK_S


class Radio:
    """What each vehicle has last received from each other one, and how old it is.

    In each tick first :meth:`receive`, then :meth:`publish`: so a message is received in the tick
    after the one in which it was published at the earliest.
    """

    def __init__(self, states: Rows, is_parked: BoolArray, errors: Perturbation) -> None:
        """Begin with a message of each vehicle's first state at every receiver.

        Args:
            states: states (F, N) of the vehicles.
            is_parked: (N,) whether a vehicle stands all the time and so avoids nobody.
            errors: delay and share of lost messages.
        """
        first = batch.message(states, None)
        flights, count = first.shape
        self._message_loss = errors.message_loss

        delay_ticks = max(1, errors.message_delay_ticks)
        self._delay_s = delay_ticks * TICK_S
        self._sent = deque([first] * delay_ticks, delay_ticks)  # newest first

        # newest message of each sender at each receiver, and its age (F, receiver, sender)
        self._inbox = np.repeat(first[:, None], count, axis=1)
        self._age_s = np.full((flights, count, count), self._delay_s)

        self._others = batch.all_others(count)
        self._is_cooperative = np.broadcast_to(~is_parked, self._age_s.shape)
        self._is_present = np.ones((flights, *self._others.shape), bool)

    def receive(self, link_draws: Array) -> tuple[Rows, BoolArray]:
        """Return the neighbours (F, N, K) of this tick, and whether each is known: all are.

        Args:
            link_draws: random numbers (F, N, N), uniform in [0, 1).
        """
        is_received = link_draws >= self._message_loss
        arriving = floats(self._sent[-1])[:, None]
        np.copyto(floats(self._inbox), arriving, where=is_received[..., None])
        self._age_s = np.where(is_received, self._delay_s, self._age_s + TICK_S)

        neighbours = batch.received(self._inbox, self._age_s, self._others, self._is_cooperative)
        return neighbours, self._is_present

    def publish(self, states: Rows, ticks: Rows | None) -> None:
        """Take the messages of this tick.

        Args:
            states: states (F, N) of the vehicles.
            ticks: what the controllers (F, N) answered to them; None: nothing yet.
        """
        self._sent.appendleft(batch.message(states, ticks))
