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
    """The newest message that each vehicle has received from each other vehicle, and its age.

    At each tick, call first :meth:`receive`, then :meth:`publish`. So a message is received at
    least one tick after it was published.
    """

    def __init__(self, states: Rows, is_parked: BoolArray, errors: Perturbation) -> None:
        """Give every receiver a message with each vehicle's first state.

        Args:
            states: states (F, N) of the vehicles.
            is_parked: (N,) whether a vehicle never moves, and so avoids no one.
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
        """Return the neighbours (F, N, K) of this tick, and whether each is known (always True).

        Args:
            link_draws: random numbers (F, receiver, sender), uniform in [0, 1). They decide which
                messages are lost.
        """
        is_received = link_draws >= self._message_loss
        arriving = floats(self._sent[-1])[:, None]
        np.copyto(floats(self._inbox), arriving, where=is_received[..., None])
        self._age_s = np.where(is_received, self._delay_s, self._age_s + TICK_S)

        neighbours = batch.received(self._inbox, self._age_s, self._others, self._is_cooperative)
        return neighbours, self._is_present

    def publish(self, states: Rows, ticks: Rows | None) -> None:
        """Publish the messages of this tick.

        Args:
            states: states (F, N) of the vehicles.
            ticks: outputs (F, N) of the vehicles' pipelines; None: there are none yet.
        """
        self._sent.appendleft(batch.message(states, ticks))
