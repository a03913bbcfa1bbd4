"""The filter of one axis as a textbook has it: matrices."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass
class MatrixKalman:
    """State [p, v, b] and covariance of one axis."""

    drag_1_s: float = 0.0
    position_noise_m: float = 0.003
    acceleration_noise: float = 0.03
    bias_noise: float = 0.12
    x: Array = field(default_factory=lambda: np.zeros(3))
    p: Array = field(default_factory=lambda: np.diag([0.003**2, 0.05**2, 0.3**2]))

    def predict(self, acceleration: float, t: float) -> None:
        """One tick of the midpoint rule for the state, and Phi P Phi' + Q for the covariance."""
        position, velocity, bias = self.x
        middle = velocity + 0.5 * t * (acceleration + bias - self.drag_1_s * velocity)
        slope = acceleration + bias - self.drag_1_s * middle
        self.x = np.array([position + t * middle, velocity + t * slope, bias])
        phi = np.array([[1, t, t * t / 2], [0, 1 - self.drag_1_s * t, t], [0, 0, 1]])
        q_a = self.acceleration_noise**2
        q_b = self.bias_noise**2
        noise = np.array(
            [[q_a * t**3 / 3, q_a * t**2 / 2, 0], [q_a * t**2 / 2, q_a * t, 0], [0, 0, q_b * t]]
        )
        self.p = phi @ self.p @ phi.T + noise

    def correct(self, innovation: float, age: float) -> None:
        """A sample that was ``age`` old, with H the first row of Phi(-age)."""
        h = np.array([1.0, -age - 0.5 * age * age * self.drag_1_s, 0.5 * age * age])
        gain = self.p @ h / (h @ self.p @ h + self.position_noise_m**2)
        self.x = self.x + gain * innovation
        self.p = self.p - np.outer(gain, h @ self.p)
