"""The quintic between two motions, from the linear equations of its coefficients."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial


def at_time(begin: tuple[float, ...], end: float, duration: float, t: float) -> list[float]:
    """Position, velocity and acceleration at ``t`` of the quintic from (p, v, a) to rest at
    ``end``.
    """
    powers = np.arange(6)
    rows = []
    values = [*begin, end, 0.0, 0.0]
    for moment in (0.0, duration):
        for order in range(3):
            factor = np.array(
                [np.prod(np.arange(k, k - order, -1)) if k >= order else 0.0 for k in powers]
            )
            rows.append(factor * np.power(moment, np.maximum(powers - order, 0), dtype=float))
    polynomial = Polynomial(np.linalg.solve(np.array(rows), np.array(values)))
    return [
        float(polynomial.deriv(order)(t)) if order else float(polynomial(t)) for order in range(3)
    ]
