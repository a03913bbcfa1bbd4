"""Facts of step responses in the air: roll, pitch, yaw, thrust."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import Fact, FactReport, number
from sitl.conformance.hover import Hover, airborne, settle
from sitl.conformance.vehicle_client import VehicleClient, quaternion, wrap

_HEIGHT_M = 4.0
_MEAN_S = 0.15  # the mean angle over this time before a step is the start of the step
# Tolerance of times: the larger of a time and a share of the measured time.
_SLACK_S = 0.02
_SLACK_SHARE = 0.12
# t63: the time to reach 63 % of a step of roll or pitch, shortest and longest as measured [s].
_TILT_TIMES = {
    "t5": (0.062, 0.073),
    "t50": (0.165, 0.175),
    "t63": (0.190, 0.200),
    "t90": (0.250, 0.260),
}
# Step of the heading [deg]: time to reach each part [s], overshoot [%].
_YAW = {
    30: ({"t5": 0.220, "t63": 0.615, "t90": 0.765}, 30.0),
    90: ({"t63": 0.736, "t90": 0.930}, 16.0),
    170: ({"t63": 1.049}, 11.0),
}
_PEAK_RATES = {10: 58.0, 20: 123.0, 30: 160.0}  # largest rate [deg/s] by step [deg]
# Tolerance of the time to 5 % of a heading step. A compass drift of one degree can be most of those
# 5 %.
_YAW_START_SLACK_S = 0.09


def _tilt_facts(axis: str, step_deg: int) -> tuple[Fact, ...]:
    name = f"step.{axis}-{step_deg}"
    says = f"{axis} step of {step_deg} deg"

    times: list[Fact] = []
    for part, (low_s, high_s) in _TILT_TIMES.items():
        least_s = low_s - _slack_s(low_s)
        most_s = high_s + _slack_s(high_s)
        words = f"{says}, {_percent(part)} % after"
        times.append(number(f"{name}-{part}", "8", words, least_s, most_s, "s"))

    rate = _PEAK_RATES[step_deg]
    return (
        *times,
        number(f"{name}-overshoot", "8", f"{says}, overshoot", 6.5, 15.0, "%"),
        number(f"{name}-peak", "8", f"{says}, largest excursion after", 0.33, 0.43, "s"),
        number(f"{name}-rate", "8", f"{says}, largest rate", 0.8 * rate, 1.2 * rate, "deg/s"),
    )


def _percent(part: str) -> int:
    """Return 63 for "t63"."""
    return int(part.removeprefix("t"))


def _slack_s(time_s: float) -> float:
    return max(_SLACK_S, _SLACK_SHARE * time_s)


def _yaw_facts(step_deg: int) -> tuple[Fact, ...]:
    name = f"step.yaw-{step_deg}"
    says = f"yaw step of {step_deg} deg"
    times_s, overshoot = _YAW[step_deg]

    times: list[Fact] = []
    for part, time_s in times_s.items():
        slack_s = _slack_s(time_s)
        if part == "t5":
            slack_s = _YAW_START_SLACK_S
        words = f"{says}, {_percent(part)} % after"
        times.append(number(f"{name}-{part}", "8", words, time_s - slack_s, time_s + slack_s, "s"))

    least = 0.65 * overshoot
    most = 1.35 * overshoot
    return (*times, number(f"{name}-overshoot", "8", f"{says}, overshoot", least, most, "%"))


_TILTS = (("roll", 10), ("roll", 20), ("roll", 30), ("pitch", 10), ("pitch", 30))
FACTS = (
    *(fact for axis, step in _TILTS for fact in _tilt_facts(axis, step)),
    *(fact for step in _YAW for fact in _yaw_facts(step)),
    # Only the largest step comes near the limit of the rate.
    number("step.yaw-170-rate", "8", "yaw step of 170 deg, largest rate", 140.0, 200.0, "deg/s"),
    number("step.thrust", "8", "climb 0.6 s after 0.1 more thrust", 0.6, 1.15, "m/s"),
)


@dataclass(frozen=True, slots=True)
class MeasuredResponse:
    """One step response."""

    times_s: list[float]  # times of the samples since the step was sent
    parts: list[float]  # fraction of the step at each time
    largest_rate_deg_s: float

    def reaches(self, part: float) -> float:
        """Return the time at which a fraction is first reached, interpolated between samples."""
        samples = zip(self.times_s, self.parts, strict=True)
        for (t0, p0), (t1, p1) in itertools.pairwise(samples):
            if t0 >= 0.0 and p0 < part <= p1:
                return t0 + (t1 - t0) * (part - p0) / (p1 - p0)
        return math.nan

    @property
    def overshoot_pct(self) -> float:
        """Largest excursion beyond the step, in percent of the step."""
        return 100.0 * (max(self.parts) - 1.0)

    @property
    def peak_s(self) -> float:
        """Time of the largest excursion."""
        return self.times_s[self.parts.index(max(self.parts))]


def run(client: VehicleClient, report: FactReport) -> None:
    """Measure the steps one after the other, and let the vehicle rest between them."""
    client.greet(as_ground_station=True)
    hover = airborne(client, _HEIGHT_M)
    for axis, step_deg in _TILTS:
        if report.wants(f"step.{axis}-{step_deg}-*"):
            _tilt(client, report, hover, axis, step_deg)
    for step_deg in _YAW:
        if report.wants(f"step.yaw-{step_deg}-*"):
            _yaw(client, report, hover, step_deg)
    if report.wants("step.thrust"):
        _thrust(client, report, hover)


def _tilt(
    client: VehicleClient, report: FactReport, hover: Hover, axis: str, step_deg: int
) -> None:
    """Step the roll or the pitch to an angle, and report the response."""
    step = math.radians(step_deg)

    def command(sign: float) -> None:
        if axis == "roll":
            hover.tilt = (sign * step, 0.0)
        else:
            hover.tilt = (0.0, sign * step)

    hover.tilt = (0.0, 0.0)
    client.wait(0.5)
    response = _record(client, axis, step, partial(command, 1.0), duration_s=0.6)
    command(-1.0)  # the opposite step removes the speed
    client.wait(0.6)
    hover.hold_here()
    client.wait(0.5)

    name = f"step.{axis}-{step_deg}"
    for part in _TILT_TIMES:
        report.add(f"{name}-{part}", response.reaches(_percent(part) / 100.0))
    report.add(f"{name}-overshoot", response.overshoot_pct)
    report.add(f"{name}-peak", response.peak_s)
    report.add(f"{name}-rate", response.largest_rate_deg_s)


def _yaw(client: VehicleClient, report: FactReport, hover: Hover, step_deg: int) -> None:
    """Step the heading by an angle, and report the response."""
    hover.tilt = (0.0, 0.0)
    client.wait(0.3)
    # Start the step at the actual heading, so that its size is right.
    hover.yaw_rad = client.euler().yaw
    client.wait(0.8)
    goal = wrap(hover.yaw_rad + math.radians(step_deg))

    def command() -> None:
        hover.yaw_rad = goal

    response = _record(client, "yaw", math.radians(step_deg), command, duration_s=2.0)
    hover.hold_here()
    settle(client, hover)

    times, _ = _YAW[step_deg]
    name = f"step.yaw-{step_deg}"
    for part in times:
        report.add(f"{name}-{part}", response.reaches(_percent(part) / 100.0))
    report.add(f"{name}-overshoot", response.overshoot_pct)
    report.add(f"{name}-rate", response.largest_rate_deg_s)


def _record(
    client: VehicleClient,
    axis: str,
    step_rad: float,
    command: Callable[[], None],
    duration_s: float,
) -> MeasuredResponse:
    """Send a step, and return the response in ATTITUDE.

    Time zero is the first ATTITUDE_TARGET with the new setpoint.

    Args:
        client: client of the vehicle.
        axis: name of the angle in ATTITUDE.
        step_rad: size of the step.
        command: function that changes the setpoint by the step.
        duration_s: duration of the record.
    """
    begin_s = client.now_s
    earlier = [packet.message for packet in client.received.of("ATTITUDE", begin_s - _MEAN_S)]
    start_rad = math.atan2(
        sum(math.sin(getattr(message, axis)) for message in earlier),
        sum(math.cos(getattr(message, axis)) for message in earlier),
    )
    target_before = client.newest("ATTITUDE_TARGET").q

    command()
    client.setpoint_duty.due_s = 0.0
    client.wait(duration_s)

    # The target has the new setpoint once it has turned by a quarter of the step. The distance
    # between two quaternions is half the angle between the attitudes. Without such a target, time
    # zero is the start of the step, _MEAN_S after the first of the earlier samples.
    zero_ms = earlier[0].time_boot_ms + 1e3 * _MEAN_S
    for packet in client.received.of("ATTITUDE_TARGET", begin_s):
        if math.dist(packet.message.q, target_before) > 0.25 * abs(step_rad) / 2:
            zero_ms = packet.message.time_boot_ms
            break

    # Angles count from the middle of the step, so that an overshoot beyond 180 deg does not become
    # negative.
    middle_rad = start_rad + 0.5 * step_rad
    samples = [packet.message for packet in client.received.of("ATTITUDE", begin_s)]
    return MeasuredResponse(
        times_s=[(message.time_boot_ms - zero_ms) * 1e-3 for message in samples],
        parts=[wrap(getattr(message, axis) - middle_rad) / step_rad + 0.5 for message in samples],
        largest_rate_deg_s=max(
            abs(math.degrees(getattr(message, f"{axis}speed"))) for message in samples
        ),
    )


def _thrust(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    """Step the thrust by 0.1 from a hover, and report the climb that follows."""
    level = quaternion(0.0, 0.0, hover.yaw_rad)
    client.stream(lambda: client.attitude(level, hover.thrust))
    client.wait(0.6)
    down_before_m_s = client.newest("LOCAL_POSITION_NED").vz

    client.stream(lambda: client.attitude(level, hover.thrust + 0.1))
    client.wait(0.6)
    report.add("step.thrust", down_before_m_s - client.newest("LOCAL_POSITION_NED").vz)

    hover.hold_here()
    client.stream(hover)
    settle(client, hover)


FACT_GROUP = FactGroup("step responses", FACTS, run)
