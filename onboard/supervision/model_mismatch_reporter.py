"""Says once per flight what the vehicle does otherwise than its fleet file says."""

from __future__ import annotations

from collections.abc import Iterator

from onboard.config.fleet import Vehicle
from onboard.estimation.disturbance_observer import ObserverMemory
from onboard.frames import Quaternion
from onboard.safety import model_mismatch
from onboard.types import TICK_S

_SAMPLE_TICKS, _LOOK_SAMPLES = 5, 10


class ModelMismatchReporter:
    """Follows one vehicle's answers to its commands."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._memory = model_mismatch.initial()
        self._ticks = self._samples = 0
        self._told: set[str] = set()

    def is_due(self) -> bool:
        """Ask at every tick in free flight: whether this one is to be followed."""
        self._ticks += 1
        return self._ticks % _SAMPLE_TICKS == 0

    def follow(self, model: ObserverMemory, attitude_wxyz: Quaternion, hover_frac: float) -> Iterator[tuple[str, str]]:
        """One sample in free flight; code and sentence of what differs and has not been said yet."""
        self._memory = model_mismatch.update(
            self._memory, model.response_enu_m_s2, model.response_rate_enu_m_s3, attitude_wxyz, _SAMPLE_TICKS * TICK_S
        )
        self._samples += 1
        if self._samples % _LOOK_SAMPLES:
            return
        vehicle = self._vehicle
        found = model_mismatch.differences(self._memory, vehicle.lag_s, hover_frac, vehicle.hover_thrust_frac)
        for code, sentence in found.items():
            if code not in self._told:
                self._told.add(code)
                yield code, sentence
