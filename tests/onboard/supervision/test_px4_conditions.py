"""A PX4 that is silent, stands still, comes back or restarts, judged by the condition table."""

from __future__ import annotations

from onboard.config.fleet import FleetSection
from onboard.safety.autopilot_monitor import AutopilotMonitor
from onboard.safety.failsafe_table import Condition
from onboard.supervision.condition_monitor import ConditionMonitor
from onboard.supervision.tick_facts import TickFacts
from tests.onboard.supervision.limits import LIMITS

TICK_NS = 20_000_000
START_NS = 10**9


class Px4:
    """A PX4 that is watched every tick; its clock and its packets can be stopped."""

    def __init__(self, limits: FleetSection = LIMITS) -> None:
        self.limits = limits
        self.monitor = AutopilotMonitor()
        self.conditions: set[Condition] = set()
        self._conditions = ConditionMonitor(limits)
        self.now_ns = START_NS
        self.boot_ns = 5 * 10**9
        self.boot_ms = 0
        self.packet_ns = START_NS
        self.attitude_ns = START_NS
        self.heartbeat_ns = START_NS

    def run(
        self, seconds: float, *, clock: float = 1.0, sends: bool = True, beats: bool = True
    ) -> None:
        """Let time pass; PX4's clock runs at a rate, and it may be silent or without heartbeat."""
        for _ in range(round(seconds / 0.02)):
            self.now_ns += TICK_NS
            self.boot_ns += round(clock * TICK_NS)
            if sends:
                self._send(beats=beats)
            self._judge()

    def _send(self, *, beats: bool) -> None:
        self.packet_ns = self.now_ns
        self.attitude_ns = self.now_ns
        if beats and self.now_ns - self.heartbeat_ns >= 10**9:
            self.heartbeat_ns = self.now_ns
        self.boot_ms = self.boot_ns // 10**6

    def _judge(self) -> None:
        self.monitor.update(
            self.now_ns,
            packet_ns=self.packet_ns,
            attitude_ns=self.attitude_ns,
            heartbeat_ns=self.heartbeat_ns,
            boot_ms=self.boot_ms,
        )
        facts = TickFacts(
            now_ns=self.now_ns,
            limits=self.limits,
            is_px4_silent=self.monitor.is_silent,
            is_px4_frozen=self.monitor.is_frozen,
            is_heartbeat_late=self.monitor.is_heartbeat_late,
            is_px4_rebooted=self.monitor.is_rebooted,
            is_px4_back=self.monitor.is_back,
        )
        self.conditions = set(self._conditions.update(facts))


def test_a_px4_whose_clock_drifts_is_well() -> None:
    for clock in (0.85, 0.96, 1.0, 1.2):
        px4 = Px4()
        px4.run(60.0, clock=clock)
        assert px4.conditions == set(), clock


def test_a_silent_px4_is_detected_within_half_a_second() -> None:
    px4 = Px4()
    px4.run(2.0)
    px4.run(0.30, sends=False)
    assert px4.conditions == set()
    px4.run(0.12, sends=False)
    assert px4.conditions == {Condition.AUTOPILOT_SILENT}
    px4.run(0.02)
    assert Condition.AUTOPILOT_SILENT not in px4.conditions


def test_packets_with_a_clock_that_stands_still_are_those_of_a_frozen_px4() -> None:
    px4 = Px4()
    px4.run(2.0)
    px4.run(0.42, clock=0.0)
    assert px4.conditions == {Condition.AUTOPILOT_FROZEN}


def test_a_px4_that_comes_back_after_a_short_standstill_is_noticed() -> None:
    for sends in (True, False):
        px4 = Px4()
        px4.run(2.0)
        px4.run(0.26, clock=0.0, sends=sends)
        px4.run(0.12)
        assert px4.conditions == {Condition.AUTOPILOT_BACK}, sends
        px4.run(3.0)
        assert px4.conditions == set(), sends


def test_packets_that_are_only_late_once_are_no_standstill() -> None:
    px4 = Px4()
    px4.run(2.0)
    px4.run(0.26, sends=False)  # the clock goes on: afterwards its packets are as fresh as before
    px4.run(1.0)
    assert px4.conditions == set()


def test_a_clock_that_begins_anew_is_a_reboot_and_nothing_else() -> None:
    px4 = Px4()
    px4.run(2.0)
    px4.boot_ns = 0
    px4.run(0.1)
    assert px4.conditions == {Condition.REBOOTED}
    px4.run(3.0)
    assert px4.conditions == set()


def test_a_missing_heartbeat_is_detected_although_everything_else_arrives() -> None:
    px4 = Px4()
    px4.run(2.0)
    px4.run(3.0, beats=False)
    assert px4.conditions == set()
    px4.run(1.5, beats=False)
    assert px4.conditions == {Condition.HEARTBEAT_LOST}
