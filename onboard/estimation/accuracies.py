"""The errors of a vehicle's estimate, for each source of positions.

The agent never publishes errors smaller than these. The checks of a fleet file use them to judge
whether the margins are wide enough.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors of a vehicle's own estimate per axis: standard deviations and correlation times."""

    name: str
    position_std_m: float
    position_time_s: float
    velocity_std_m_s: float
    velocity_time_s: float
    acceleration_std_m_s2: float = 0.1  # gusts that accelerate only one vehicle of a pair
    acceleration_time_s: float = 1.5


ACCURACIES = {
    # the agent's own Kalman filter, on mocap samples with a noise of 3 mm
    "mocap": Accuracy(
        name="mocap",
        position_std_m=0.003,
        position_time_s=0.05,
        velocity_std_m_s=0.03,
        velocity_time_s=0.1,
    ),
    # PX4's estimate with external vision
    "vision": Accuracy(
        name="vision",
        position_std_m=0.05,
        position_time_s=0.5,
        velocity_std_m_s=0.12,
        velocity_time_s=0.5,
    ),
    # PX4's estimate with GPS
    "gps": Accuracy(
        name="gps",
        position_std_m=0.2,
        position_time_s=5.0,
        velocity_std_m_s=0.2,
        velocity_time_s=0.7,
    ),
}
