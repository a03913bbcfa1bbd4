"""Detects a PX4 that is silent, frozen, rebooted, or back after a standstill. Pure.

It judges by ages and by PX4's own clock. A link that repeats old messages, or a PX4 whose scheduler
stands still, sends packets with a clock that does not move. A PX4 that stood still and goes on
shows a clock that has lost time against ours.
"""

from __future__ import annotations

from dataclasses import dataclass

from onboard.safety.limits import AUTOPILOT_SILENT_S

FROZEN_S = 0.3
HEARTBEAT_LOST_S = 3.2  # three of them, at 1 Hz
STANDSTILL_S = 0.15
REBOOT_MS = 1000
REPORTED_S = 2.0  # for so long a reboot or a standstill counts as a condition
# in the first ticks of a process that was not scheduled for a while, everything is old
_LIVE_TICKS = 5
_CREEP = 0.2  # s per s by which a clock may lose time: a simulated PX4 on a loaded machine does


@dataclass(slots=True)
class AutopilotMonitor:
    """Memory of one PX4; call :meth:`update` every tick. Times on our clock [ns]."""

    is_silent: bool = False
    is_frozen: bool = False
    is_heartbeat_lost: bool = False
    is_rebooted: bool = False  # in the last seconds
    is_back: bool = False  # in the last seconds, after a standstill
    _boot_ms: int = 0
    _moved_ns: int = 0
    _offset_ns: float = 0.0
    _rebooted_ns: int = 0
    _back_ns: int = 0
    _silent_ticks: int = 0
    _frozen_ticks: int = 0
    _heartbeat_ticks: int = 0
    _lost_ticks: int = 0

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
        is_silent = now_ns - packet_ns > AUTOPILOT_SILENT_S * 1e9
        self._silent_ticks = self._silent_ticks + 1 if is_silent else 0
        if boot_ms != self._boot_ms:
            if boot_ms + REBOOT_MS < self._boot_ms:
                self._rebooted_ns, self._offset_ns = now_ns, 0.0
            self._compare_clocks(now_ns, attitude_ns - 1e6 * boot_ms)
            self._boot_ms, self._moved_ns = boot_ms, now_ns
        # a clock that never arrived (0) does not stand still
        is_frozen = (
            bool(self._boot_ms) and not is_silent and now_ns - self._moved_ns > FROZEN_S * 1e9
        )
        self._frozen_ticks = self._frozen_ticks + 1 if is_frozen else 0
        has_late_beat = (
            not is_silent and bool(heartbeat_ns) and now_ns - heartbeat_ns > HEARTBEAT_LOST_S * 1e9
        )
        self._heartbeat_ticks = self._heartbeat_ticks + 1 if has_late_beat else 0
        self.is_silent = self._silent_ticks >= _LIVE_TICKS
        self.is_frozen = self._frozen_ticks >= _LIVE_TICKS
        self.is_heartbeat_lost = self._heartbeat_ticks >= _LIVE_TICKS
        self.is_rebooted = bool(self._rebooted_ns) and now_ns - self._rebooted_ns < REPORTED_S * 1e9
        self.is_back = bool(self._back_ns) and now_ns - self._back_ns < REPORTED_S * 1e9

    def _compare_clocks(self, now_ns: int, offset_ns: float) -> None:
        """Compare both clocks: a delay of the link passes, time that PX4 has lost stays lost."""
        if not self._offset_ns:
            self._offset_ns = offset_ns
        self._offset_ns += _CREEP * (now_ns - self._moved_ns) if self._moved_ns else 0.0
        shift_ns = offset_ns - self._offset_ns
        self._lost_ticks = self._lost_ticks + 1 if abs(shift_ns) > STANDSTILL_S * 1e9 else 0
        if self._lost_ticks >= _LIVE_TICKS:
            self._back_ns = now_ns if shift_ns > 0.0 else self._back_ns
            self._offset_ns, self._lost_ticks = offset_ns, 0
        elif not self._lost_ticks:
            self._offset_ns = min(self._offset_ns, offset_ns)
