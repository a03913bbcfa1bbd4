"""A PX4 that is silent, frozen, rebooted, or back after a standstill, by its clock and ours."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from onboard.safety.autopilot_monitor import AutopilotMonitor
from onboard.safety.limits import AUTOPILOT_SILENT_S

MS = 1_000_000
BEGIN_MS = 100_000  # our clock at the first tick
BOOT_MS = 60_000  # PX4's clock then


@dataclass
class Px4:
    """A monitor, and what it is told: a tick each 20 ms, an attitude in each."""

    monitor: AutopilotMonitor = field(default_factory=AutopilotMonitor)
    now_ms: int = BEGIN_MS
    boot_ms: int = BOOT_MS
    heartbeat_ms: int = BEGIN_MS

    def tick(self, *, late_ms: int = 0, packet_age_ms: int = 0) -> AutopilotMonitor:
        """Take one tick, whose attitude arrived so long before."""
        self.monitor.update(
            self.now_ms * MS,
            packet_ns=(self.now_ms - packet_age_ms) * MS,
            attitude_ns=(self.now_ms - late_ms) * MS,
            heartbeat_ns=self.heartbeat_ms * MS,
            boot_ms=self.boot_ms,
        )
        return self.monitor

    def run(self, seconds: float, *, px4_lasts: float = 1.0) -> AutopilotMonitor:
        """Take ticks in which PX4's clock advances at this share of ours."""
        for _ in range(round(seconds / 0.02)):
            self.now_ms += 20
            self.boot_ms += round(20 * px4_lasts)
            self.heartbeat_ms = self.now_ms
            self.tick()
        return self.monitor


def flags(monitor: AutopilotMonitor) -> set[str]:
    """What the monitor says, in words."""
    names = ("is_silent", "is_frozen", "is_heartbeat_late", "is_rebooted", "is_back")
    return {name for name in names if getattr(monitor, name)}


def test_a_px4_that_was_never_heard_is_silent_and_nothing_else() -> None:
    monitor = AutopilotMonitor()
    now_ns = BEGIN_MS * MS
    monitor.update(now_ns, packet_ns=0, attitude_ns=0, heartbeat_ns=0, boot_ms=0)
    assert flags(monitor) == {"is_silent"}

    # packets come, but no attitude and no heartbeat yet
    monitor.update(now_ns, packet_ns=now_ns, attitude_ns=0, heartbeat_ns=0, boot_ms=0)
    assert flags(monitor) == set()


def test_a_second_after_the_start_of_this_computer_nothing_has_happened_to_px4() -> None:
    px4 = Px4(now_ms=1000, heartbeat_ms=1000)
    assert flags(px4.tick()) == set()


def test_packets_heartbeats_and_the_clock_count_after_their_times() -> None:
    px4 = Px4()
    assert flags(px4.run(1.0)) == set()

    silent_ms = round(AUTOPILOT_SILENT_S * 1000)
    assert flags(px4.tick(packet_age_ms=silent_ms)) == set()
    assert flags(px4.tick(packet_age_ms=silent_ms + 1)) == {"is_silent"}

    px4.now_ms += 300
    assert flags(px4.tick()) == set()
    px4.now_ms += 1
    assert flags(px4.tick()) == {"is_frozen"}
    assert flags(px4.tick(packet_age_ms=1000)) == {"is_silent"}

    px4.boot_ms += 301
    px4.now_ms = px4.heartbeat_ms + 3200
    assert "is_heartbeat_late" not in flags(px4.tick())
    px4.now_ms += 1
    assert "is_heartbeat_late" in flags(px4.tick())
    assert "is_heartbeat_late" not in flags(px4.tick(packet_age_ms=1000))


def test_a_clock_that_goes_back_by_more_than_a_second_is_a_reboot_for_two_seconds() -> None:
    px4 = Px4()
    px4.run(1.0)
    px4.boot_ms -= 1000
    assert "is_rebooted" not in flags(px4.tick())

    px4 = Px4()
    px4.run(1.0)
    px4.boot_ms -= 1001
    assert flags(px4.tick()) == {"is_rebooted"}
    assert flags(px4.run(1.98)) == {"is_rebooted"}
    assert flags(px4.run(0.02)) == set()


@pytest.mark.parametrize(("lost_ms", "is_back"), [(140, False), (200, True)])
def test_a_px4_whose_clock_has_lost_time_is_back_after_a_standstill(
    lost_ms: int, is_back: bool
) -> None:
    px4 = Px4()
    px4.run(1.0)
    px4.boot_ms -= lost_ms
    assert flags(px4.run(0.08)) == set(), "four attitudes with the same shift are not enough"
    assert flags(px4.run(0.02)) == ({"is_back"} if is_back else set())

    # the new difference of both clocks counts from now on
    assert flags(px4.run(1.98)) == ({"is_back"} if is_back else set())
    assert flags(px4.run(3.0)) == set()


def test_time_that_px4_loses_right_after_its_first_attitude_is_a_standstill() -> None:
    px4 = Px4()
    px4.tick()
    px4.boot_ms -= 200
    assert flags(px4.run(0.1)) == {"is_back"}


def test_a_shift_that_does_not_last_and_a_clock_that_gains_time_are_no_standstill() -> None:
    px4 = Px4()
    px4.run(1.0)
    for _ in range(3):
        px4.boot_ms -= 200
        px4.run(0.06)
        px4.boot_ms += 200
        assert flags(px4.run(0.1)) == set()

    px4.boot_ms += 5000
    assert flags(px4.run(3.0)) == set()


def test_a_simulated_px4_may_run_a_sixth_slower_for_ever_and_one_a_third_slower_may_not() -> None:
    px4 = Px4()
    px4.run(1.0)
    assert flags(px4.run(10.0, px4_lasts=0.85)) == set()
    assert "is_back" in flags(px4.run(3.0, px4_lasts=0.7))
