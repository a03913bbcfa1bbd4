"""Detects that PX4 has left the mode that the flight needs: OFFBOARD, or LAND while PX4 lands.

It distinguishes a pilot who flies with the sticks from all other reasons.
"""

from __future__ import annotations

from dataclasses import dataclass

from onboard.autopilot import Snapshot
from onboard.flight.context import FlightContext
from onboard.flight.types import MUST_BE_ARMED, MUST_BE_OFFBOARD, FlightStep
from onboard.safety.failsafe_table import Situation
from onboard.supervision.tick_facts import ModeLoss

# In these steps on the ground, the agent requests OFFBOARD from PX4 unless a pilot flies.
_STARTING = (FlightStep.ARM_OFFBOARD, FlightStep.TAKEOFF_OFFBOARD)


@dataclass(slots=True)
class OffboardMonitor:
    """Memory of the modes of one flight; call :meth:`update` every tick.

    Only a heartbeat gives PX4's mode, and it arrives once a second. So a heartbeat counts only if
    it has arrived since the start of the flight step that needs the mode.
    """

    _not_needed_ns: int = 0  # last tick at which the flight did not need OFFBOARD
    _has_landing_mode: bool = False  # PX4 has confirmed its landing

    def update(
        self, now_ns: int, snapshot: Snapshot, flight: FlightContext, *, is_on_ground: bool
    ) -> ModeLoss:
        """Take one tick; return how PX4 has left the mode that the flight needs.

        Args:
            now_ns: our clock.
            snapshot: newest reports of PX4.
            flight: flight in progress.
            is_on_ground: whether a recent report of PX4 says that the vehicle is on the ground.
        """
        is_flown_by_hand = snapshot.is_flown_by_hand(now_ns)
        if flight.step is FlightStep.PX4_LANDING:
            self._not_needed_ns = now_ns
            # a landing that a person orders may begin in a pilot's mode
            if is_flown_by_hand and not flight.lands_for_a_person and not is_on_ground:
                return ModeLoss.BY_HAND
            return self._while_px4_lands(snapshot, is_on_ground=is_on_ground)

        if flight.step.situation is Situation.SILENT:
            self._has_landing_mode = False
            self._not_needed_ns = now_ns
            if is_flown_by_hand:
                return ModeLoss.BY_HAND
            return ModeLoss.NONE

        self._has_landing_mode = False
        if flight.step not in MUST_BE_OFFBOARD:
            self._not_needed_ns = now_ns
            if is_flown_by_hand and flight.step in _STARTING:
                return ModeLoss.BY_HAND
            return ModeLoss.NONE

        if snapshot.heartbeat_ns <= self._not_needed_ns:
            return ModeLoss.NONE
        if not snapshot.is_armed and flight.step in MUST_BE_ARMED:
            return ModeLoss.DISARMED
        if snapshot.is_offboard:
            return ModeLoss.NONE
        if is_flown_by_hand:
            return ModeLoss.BY_HAND
        if snapshot.is_failsafe:
            return ModeLoss.FAILSAFE
        return ModeLoss.LEFT

    def _while_px4_lands(self, snapshot: Snapshot, *, is_on_ground: bool) -> ModeLoss:
        is_landing = snapshot.mode == "LAND"
        was_landing = self._has_landing_mode
        self._has_landing_mode = was_landing or is_landing

        # A mode other than LAND is not a loss on the ground or in PX4's own failsafe, which also
        # lands the vehicle.
        has_left_landing = was_landing and not is_landing
        if has_left_landing and not is_on_ground and not snapshot.is_failsafe:
            return ModeLoss.LEFT
        return ModeLoss.NONE
