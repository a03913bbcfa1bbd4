"""Reports once per flight each difference between the vehicle's response and its fleet file."""

from __future__ import annotations

from onboard.config.fleet import Vehicle
from onboard.estimation.disturbance_observer import ObserverMemory
from onboard.frames import Quaternion
from onboard.safety import model_mismatch
from onboard.types import TICK_S

_SAMPLE_TICKS = 5  # number of ticks between two samples
_COMPARE_SAMPLES = 10  # number of samples between two comparisons with the fleet file


class ModelMismatchReporter:
    """Follows one vehicle's response to its commands."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.begin_flight()

    def begin_flight(self) -> None:
        """Forget the last flight: its samples, and what was reported."""
        self._memory = model_mismatch.initial()
        self._tick_count = 0
        self._sample_count = 0
        self._reported: set[str] = set()

    def is_due(self) -> bool:
        """Return whether this tick in free flight is a sample. Call it at every tick in free
        flight.
        """
        self._tick_count += 1
        return self._tick_count % _SAMPLE_TICKS == 0

    def update(
        self, model: ObserverMemory, attitude_wxyz: Quaternion, hover_frac: float
    ) -> list[tuple[str, str]]:
        """Take a sample; return code and sentence of each difference that is not reported yet.

        Args:
            model: memory of the disturbance observer, which models the response to the commands.
            attitude_wxyz: measured attitude, FLU to ENU.
            hover_frac: hover throttle learned so far.
        """
        self._memory = model_mismatch.update(
            self._memory,
            model.response_enu_m_s2,
            model.response_rate_enu_m_s3,
            attitude_wxyz,
            _SAMPLE_TICKS * TICK_S,
        )
        self._sample_count += 1
        if self._sample_count % _COMPARE_SAMPLES != 0:
            return []

        sentences = model_mismatch.differences(
            self._memory, self._vehicle.lag_s, hover_frac, self._vehicle.hover_thrust_frac
        )
        new = [(code, text) for code, text in sentences.items() if code not in self._reported]
        self._reported.update(sentences)
        return new
