"""Detects a PX4 that is silent, frozen, rebooted, or back after a standstill. Pure.

It judges by ages and by PX4's own clock. A link that repeats old messages, or a PX4 whose scheduler
stands still, sends packets with a clock that does not move. A PX4 that stood still and goes on
shows a clock that has lost time against ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from onboard.safety.held import Held
from onboard.safety.limits import AUTOPILOT_SILENT_S

FROZEN_S = 0.3
HEARTBEAT_LATE_S = 3.2  # three of them, at 1 Hz
STANDSTILL_S = 0.15
REBOOT_MS = 1000
REPORTED_S = 2.0  # for so long a reboot or a standstill counts as a condition
# In the first ticks of a process that was not scheduled for a while, everything is old.
_AGREEING_ATTITUDES = 5
_CREEP = 0.2  # s per s by which a clock may lose time: a simulated PX4 on a loaded machine does


@dataclass(slots=True)
class AutopilotMonitor:
    """Memory of one PX4; call :meth:`update` every tick.

    The first three facts are those of one tick: whether they last, the condition table judges.
    """

    is_silent: bool = False  # no packet
    is_frozen: bool = False  # packets, and a clock that stands still
    is_heartbeat_late: bool = False  # although there are packets
    is_rebooted: bool = False  # in the last seconds
    is_back: bool = False  # in the last seconds, after a standstill

    _boot_ms: int = 0  # PX4's clock as it came last; 0 before the first
    _moved_ns: int = 0  # when that was, by our clock; 0 never
    # Our clock minus PX4's, as long as PX4 loses no time [ns]; 0: not known
    _offset_ns: float = 0.0
    _rebooted_ns: int = 0  # 0 never
    _back_ns: int = 0  # 0 never
    _shifted: Held = field(default_factory=Held)  # the offset differs, attitude by attitude

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

        self.is_rebooted = _is_recent(self._rebooted_ns, now_ns)
        self.is_back = _is_recent(self._back_ns, now_ns)

    def _take_clock(self, now_ns: int, attitude_ns: int, boot_ms: int) -> None:
        if boot_ms + REBOOT_MS < self._boot_ms:
            self._rebooted_ns = now_ns
            self._offset_ns = 0.0
        self._compare_clocks(now_ns, attitude_ns - 1e6 * boot_ms)
        self._boot_ms = boot_ms
        self._moved_ns = now_ns

    def _compare_clocks(self, now_ns: int, offset_ns: float) -> None:
        """Compare both clocks: a delay of the link passes, time that PX4 has lost stays lost."""
        if not self._offset_ns:
            self._offset_ns = offset_ns
        if self._moved_ns:
            self._offset_ns += _CREEP * (now_ns - self._moved_ns)

        shift_ns = offset_ns - self._offset_ns
        if abs(shift_ns) <= STANDSTILL_S * 1e9:
            self._shifted.checks = 0
            self._offset_ns = min(self._offset_ns, offset_ns)
            return

        self._shifted.see(now_ns)
        if self._shifted.checks >= _AGREEING_ATTITUDES:
            if shift_ns > 0.0:
                self._back_ns = now_ns
            self._offset_ns = offset_ns
            self._shifted.checks = 0


def _is_recent(then_ns: int, now_ns: int) -> bool:
    return then_ns != 0 and now_ns - then_ns < REPORTED_S * 1e9
