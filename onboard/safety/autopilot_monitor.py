"""Detects whether PX4 is silent, frozen, rebooted, or running again after a standstill. Pure.

If the link repeats old messages, or PX4 stands still, packets arrive but PX4's clock in them does
not advance. After a standstill, PX4's clock has lost time against ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from onboard.safety.condition_timer import ConditionTimer
from onboard.safety.limits import AUTOPILOT_SILENT_S

FROZEN_S = 0.3  # PX4 is frozen if its clock has not advanced for longer than this
HEARTBEAT_LATE_S = 3.2  # three heartbeats at 1 Hz are missing
STANDSTILL_S = 0.15  # PX4 stood still if its clock has lost more than this against ours
REBOOT_MS = 1000  # PX4 was rebooted if its clock went back by more than this
REPORTED_S = 2.0  # a reboot or a standstill counts as a condition for this time

_REPORTED_NS = int(REPORTED_S * 1e9)

# A standstill counts only after this number of attitudes in a row with the same shift. When a
# process resumes after not being scheduled for a while, all messages look old in the first ticks.
_AGREEING_ATTITUDES = 5

# PX4's clock may run slower than ours by this share, as in a simulation on a loaded machine.
_CREEP = 0.2


@dataclass(slots=True)
class AutopilotMonitor:
    """Memory of one PX4; call :meth:`update` every tick.

    The first three booleans describe one tick only.
    """

    is_silent: bool = False  # no packet arrives
    is_frozen: bool = False  # packets arrive, but PX4's clock does not advance
    is_heartbeat_late: bool = False  # packets arrive, but no heartbeat
    is_rebooted: bool = False  # PX4 rebooted within the last REPORTED_S
    is_back: bool = False  # PX4 ran again after a standstill, within the last REPORTED_S

    _boot_ms: int = 0  # PX4's clock in its newest attitude; 0 before the first
    _moved_ns: int = 0  # our time when PX4's clock last advanced; 0 never
    _offset_ns: float = 0.0  # our clock minus PX4's, unless PX4 loses time; 0: not known
    # the last reboot and the last end of a standstill are reported until these times, by our clock;
    # 0: none
    _rebooted_until_ns: int = 0
    _back_until_ns: int = 0
    # counts attitudes in a row whose clock offset differs from _offset_ns
    _shifted: ConditionTimer = field(default_factory=ConditionTimer)

    def update(
        self, now_ns: int, *, packet_ns: int, attitude_ns: int, heartbeat_ns: int, boot_ms: int
    ) -> None:
        """Take one tick.

        Args:
            now_ns: our clock.
            packet_ns: arrival of the newest packet; 0 never.
            attitude_ns: arrival of the newest attitude; 0 never.
            heartbeat_ns: arrival of the newest heartbeat; 0 never.
            boot_ms: PX4's clock in its newest attitude; 0 before the first.
        """
        if boot_ms != self._boot_ms:
            self._take_clock(now_ns, attitude_ns, boot_ms)

        self.is_silent = now_ns - packet_ns > AUTOPILOT_SILENT_S * 1e9
        # a clock or a heartbeat that never arrived (0) is not late
        stands_still = self._boot_ms != 0 and now_ns - self._moved_ns > FROZEN_S * 1e9
        has_no_beat = heartbeat_ns != 0 and now_ns - heartbeat_ns > HEARTBEAT_LATE_S * 1e9
        self.is_frozen = stands_still and not self.is_silent
        self.is_heartbeat_late = has_no_beat and not self.is_silent

        self.is_rebooted = now_ns < self._rebooted_until_ns
        self.is_back = now_ns < self._back_until_ns

    def _take_clock(self, now_ns: int, attitude_ns: int, boot_ms: int) -> None:
        """Process a time of PX4's clock that differs from the last one."""
        if boot_ms + REBOOT_MS < self._boot_ms:
            self._rebooted_until_ns = now_ns + _REPORTED_NS
            self._offset_ns = 0.0
        offset_ns = attitude_ns - 1e6 * boot_ms
        self._compare_clocks(now_ns, offset_ns)
        self._boot_ms = boot_ms
        self._moved_ns = now_ns

    def _compare_clocks(self, now_ns: int, offset_ns: float) -> None:
        """Compare our clock minus PX4's with the earlier offset, to see whether PX4 has lost time.

        A delay of the link shifts the offset only briefly, but time that PX4 has lost shifts it
        permanently. A delay makes the offset larger, so the smallest offset is nearest to the
        truth.
        """
        if not self._offset_ns:
            self._offset_ns = offset_ns
        if self._moved_ns:  # if PX4's clock is slow, the offset grows
            self._offset_ns += _CREEP * (now_ns - self._moved_ns)

        shift_ns = offset_ns - self._offset_ns
        if abs(shift_ns) <= STANDSTILL_S * 1e9:
            self._shifted.end()
            self._offset_ns = min(self._offset_ns, offset_ns)
            return

        self._shifted.see(now_ns)
        if self._shifted.checks >= _AGREEING_ATTITUDES:
            if shift_ns > 0.0:
                self._back_until_ns = now_ns + _REPORTED_NS
            self._offset_ns = offset_ns
            self._shifted.end()
