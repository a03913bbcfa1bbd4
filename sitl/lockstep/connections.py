"""The quality of a simulated bus connection, and the choice of the messages that it loses."""

from __future__ import annotations

from dataclasses import dataclass, replace

from onboard.config.fleet import ConfigError, RadioConfig

Pair = tuple[str, str]

LONGEST_BUS_DELAY_S = 10.0  # of a connection, and the largest mean of its jitter
_PERIOD_NS = 20_000_000  # period of 50 Hz messages
_FORGOTTEN_NS = 10_000_000_000  # a message older than this has no influence


@dataclass(frozen=True, slots=True)
class BusSettings:
    """Quality of every connection."""

    delay_s: float = 0.001  # shortest time from sender to receiver
    jitter_s: float = 0.0  # mean of the additional delay, which is exponentially distributed
    loss: float = 0.0  # share of the messages that are lost
    # mean number of 50 Hz messages that a connection loses in a row; 1: losses are independent
    burst: float = 1.0
    reorder: float = 0.0  # chance that a message is reordered
    reorder_s: float = 0.04  # time for which a reordered message is held back
    duplicate: float = 0.0  # chance that a message arrives twice

    def __post_init__(self) -> None:
        for name in ("delay_s", "jitter_s", "reorder_s"):
            time_s = getattr(self, name)
            if not 0.0 <= time_s <= LONGEST_BUS_DELAY_S:
                raise ConfigError(f"The bus's {name} is {time_s}; it must lie between 0 and 10 s.")

        for name in ("loss", "reorder", "duplicate"):
            chance = getattr(self, name)
            if not 0.0 <= chance <= 1.0:
                raise ConfigError(
                    f"The bus's {name} is {chance}, but it is a chance: between 0 and 1."
                )

        if not 1.0 <= self.burst <= 1000.0:
            raise ConfigError(
                f"The bus's burst is {self.burst}, a number of messages: it must lie between 1 and "
                "1000."
            )

    @property
    def is_random(self) -> bool:
        """Whether messages need random numbers, because they are not all treated alike."""
        return self.jitter_s > 0.0 or self.loss > 0.0 or self.reorder > 0.0 or self.duplicate > 0.0

    def over(self, radio: RadioConfig | None) -> BusSettings:
        """Return these settings combined with the quality of the fleet's radio."""
        if radio is None:
            return self

        return replace(
            self,
            jitter_s=self.jitter_s + radio.jitter_s,
            loss=1.0 - (1.0 - self.loss) * (1.0 - radio.loss_frac),
            burst=max(self.burst, radio.burst_packets),
            reorder=max(self.reorder, radio.reorder_frac),
            duplicate=max(self.duplicate, radio.duplicate_frac),
        )


class Losses:
    """Chooses the messages that are lost, and remembers the last message of each connection.

    Each connection is the two-state chain of Gilbert and Elliott: in one state it loses every
    message, in the other none. A state lasts for a time, not for a number of messages. The settings
    express this time as a number of 50 Hz messages. A 5 Hz connection therefore loses fewer
    messages in a row. Messages sent at the same instant are either all lost or all delivered.
    """

    def __init__(self) -> None:
        # pair -> time [ns] of its last message, and whether that was lost
        self._newest: dict[Pair, tuple[int, bool]] = {}

    def takes(self, pair: Pair, settings: BusSettings, draw: float, now_ns: int) -> bool:
        """Return whether the next message of a connection is lost.

        Args:
            pair: the connection.
            settings: its quality.
            draw: a random number, uniform in [0, 1).
            now_ns: when the message is sent.
        """
        loss = settings.loss
        if settings.burst <= 1.0 or not 0.0 < loss < 1.0:
            return draw < loss

        newest_ns, was_lost = self._newest.get(pair, (-_FORGOTTEN_NS, False))
        periods = (now_ns - newest_ns) / _PERIOD_NS

        # In one period the chain leaves the loss state with probability 1 / burst. It enters that
        # state with probability leave * loss / (1 - loss), so that it spends the share `loss` of
        # the time there. One minus both probabilities is the correlation of two messages one period
        # apart.
        leave = 1.0 / settings.burst
        correlation = max(0.0, 1.0 - leave - leave * loss / (1.0 - loss)) ** periods

        # right after the newest message the probability is 0 or 1; with time it approaches `loss`
        newest_chance = 0.0
        if was_lost:
            newest_chance = 1.0
        chance = loss + (newest_chance - loss) * correlation

        is_lost = bool(draw < chance)
        self._newest[pair] = (now_ns, is_lost)
        return is_lost
