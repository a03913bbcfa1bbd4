"""Reports once per flight that the vehicle responds otherwise than its fleet file says."""

from __future__ import annotations

from collections.abc import Iterator

from onboard.config.fleet import Vehicle
from onboard.estimation.disturbance_observer import ObserverMemory
from onboard.frames import Quaternion
from onboard.safety import model_mismatch
from onboard.types import TICK_S

_SAMPLE_TICKS, _COMPARE_SAMPLES = 5, 10


class ModelMismatchReporter:
    """Follows one vehicle's response to its commands."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._memory = model_mismatch.initial()
        self._tick_count = self._samples = 0
        self._reported: set[str] = set()

    def is_due(self) -> bool:
        """Whether this tick in free flight is to be followed; call it at every such tick."""
        self._tick_count += 1
        return self._tick_count % _SAMPLE_TICKS == 0

    def follow(
        self, model: ObserverMemory, attitude_wxyz: Quaternion, hover_frac: float
    ) -> Iterator[tuple[str, str]]:
        """Take one sample in free flight; yield code and sentence of each difference that is not
        reported yet.
        """
        self._memory = model_mismatch.update(
            self._memory,
            model.response_enu_m_s2,
            model.response_rate_enu_m_s3,
            attitude_wxyz,
            _SAMPLE_TICKS * TICK_S,
        )
        self._samples += 1
        if self._samples % _COMPARE_SAMPLES:
            return
        vehicle = self._vehicle
        sentences = model_mismatch.differences(
            self._memory, vehicle.lag_s, hover_frac, vehicle.hover_thrust_frac
        )
        for code, sentence in sentences.items():
            if code not in self._reported:
                self._reported.add(code)
                yield code, sentence
