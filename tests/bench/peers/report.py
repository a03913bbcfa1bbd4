"""Flights in, numbers with their intervals out: what a method did in all its flights, and tables of
that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Outcome:
    """One flight.

    Separation is the true one; ratio is the makespan over that of everybody flying alone.
    """

    scenario: str
    seed: int
    success: bool
    min_separation_m: float
    violation_s: float
    collision: bool
    ratio: float
    relaxed_share: float
    slew_m_s3: float
    max_speed_m_s: float


@dataclass(frozen=True, slots=True)
class Summary:
    """All flights of one method.

    Shares in [0, 1]; ``ratio`` is the mean over the flights that succeeded.
    """

    flights: int
    successes: int
    violations: int
    collisions: int
    worst_m: float
    low_m: float
    ratio: float
    slew_m_s3: float
    max_speed_m_s: float
    relaxed_share: float
    us_per_step: float

    @property
    def order(self) -> tuple[float, float, float]:
        """Return the sorting key, better first: fewer violations, then more successes, then a
        smaller ratio.
        """
        return (self.violations / self.flights, -self.successes / self.flights, self.ratio)


def summary(outcomes: Sequence[Outcome], us_per_step: float = math.nan) -> Summary:
    """Count and average flights, at least one."""
    separations = np.array([outcome.min_separation_m for outcome in outcomes])
    ratios = [outcome.ratio for outcome in outcomes if outcome.success]
    return Summary(
        flights=len(outcomes),
        successes=sum(outcome.success for outcome in outcomes),
        violations=sum(outcome.violation_s > 0.0 for outcome in outcomes),
        collisions=sum(outcome.collision for outcome in outcomes),
        worst_m=float(separations.min()),
        low_m=float(np.percentile(separations, 5.0)),
        ratio=float(np.mean(ratios)) if ratios else math.nan,
        slew_m_s3=float(np.sqrt(np.mean([outcome.slew_m_s3**2 for outcome in outcomes]))),
        max_speed_m_s=max(outcome.max_speed_m_s for outcome in outcomes),
        relaxed_share=float(np.mean([outcome.relaxed_share for outcome in outcomes])),
        us_per_step=us_per_step,
    )


def interval(hits: int, count: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact (Clopper-Pearson) interval of a share; with no hit or only hits it is one-sided: 0 of n
    is below 3/n.
    """
    miss = (1.0 - confidence) / (1.0 if hits in (0, count) else 2.0)

    def at_most(k: int, share: float) -> float:
        if share <= 0.0 or share >= 1.0:
            return 1.0 if share <= 0.0 or k >= count else 0.0
        logs = [
            math.lgamma(count + 1) - math.lgamma(i + 1) - math.lgamma(count - i + 1)
            + i * math.log(share) + (count - i) * math.log1p(-share)
            for i in range(k + 1)
        ]  # fmt: skip
        return math.fsum(map(math.exp, logs))

    def solve(k: int, level: float) -> float:
        low = 0.0
        high = 1.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if at_most(k, middle) > level else (low, middle)
        return 0.5 * (low + high)

    lower = 0.0 if hits == 0 else solve(hits - 1, 1.0 - miss)
    upper = 1.0 if hits == count else solve(hits, miss)
    return lower, upper


def share(hits: int, count: int) -> str:
    """``12 % (8-17)``: a share with its interval, in per cent."""
    low, high = interval(hits, count)
    return f"{_percent(hits / count)} % ({_percent(low)}-{_percent(high)})"


def _percent(value: float) -> str:
    return f"{100.0 * value:.1f}" if 0.0 < value < 0.1 else f"{100.0 * value:.0f}"


def table(rows: Mapping[str, Summary], first: str = "method", *, has_cost: bool = True) -> str:
    """A Markdown table, a line for each method; ``has_cost`` for the microseconds."""
    lines = [
        f"| {first} | flights | success | below 0.80 m (95 %) | collisions | worst m | 5th "
        "percentile m | ratio "
        f"| slew m/s³ | top speed m/s |{' µs per vehicle and step |' * has_cost}",
        "|---" * (10 + has_cost) + "|",
    ]
    for name, s in rows.items():
        lines.append(
            f"| {name} | {s.flights} | {100.0 * s.successes / s.flights:.0f} % | "
            f"{share(s.violations, s.flights)} "
            f"| {s.collisions} | {s.worst_m:.3f} | {s.low_m:.3f} | {s.ratio:.2f} | "
            f"{s.slew_m_s3:.0f} "
            f"| {s.max_speed_m_s:.2f} |" + f" {s.us_per_step:.1f} |" * has_cost
        )
    return "\n".join(lines)
