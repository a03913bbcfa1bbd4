"""Flights in, numbers with their intervals out: what a method did in all its flights, and tables of
that.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from onboard.confidence_intervals import exact_interval


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


def share(hits: int, count: int) -> str:
    """``12 % (8-17)``: a share with its interval, in per cent."""
    interval = exact_interval(hits, count)
    return f"{_percent(hits / count)} % ({_percent(interval.low)}-{_percent(interval.high)})"


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
