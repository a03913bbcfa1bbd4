"""Values of one vehicle's pipeline: thrust before and after OIST, attitude, both also as charts.
Pure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from rich.segment import Segment
from textual.strip import Strip

from groundstation.console.canvas import Canvas
from groundstation.console.theme import CALM, FAINT, RULE, TEXT, WARN, clean, number
from groundstation.console.vehicle_subject import Text, VehicleSubject
from onboard.arrays import Array
from onboard.bus.schema import TickSample, Vec3, Vec4

CHART_S = 20.0


def thrust_block(subject: VehicleSubject, width: int) -> list[Text | Strip]:
    """Return the thrust before and after OIST, as numbers and as a chart."""
    tick = subject.tick
    if tick is None:
        return [[(" no pipeline values heard yet", FAINT)]]
    lines: list[Text | Strip] = [
        [(" baseline   ", FAINT), (_vector(tick.thrust_baseline_enu_m_s2), WARN)],
        [(" safe       ", FAINT), (_vector(tick.thrust_safe_enu_m_s2), CALM)],
    ]
    held = tick.intervention_m_s2
    is_held = math.isfinite(held) and held > 0.01
    neighbour = f" for {clean(tick.active_neighbour, 24)}" if tick.active_neighbour else ""
    words = (
        f"{number(held, 2)}{neighbour}, {clean(tick.law_status, 16)}"
        if is_held
        else "nothing: it passes unchanged"
    )
    lines.append([(" held back  ", FAINT), (words, CALM if is_held else FAINT)])
    times = _times(subject.tick_samples)
    nominal = np.array(
        [each.thrust_baseline_enu_m_s2[:2] for each in subject.tick_samples], dtype=float
    )
    safe = np.array([each.thrust_safe_enu_m_s2[:2] for each in subject.tick_samples], dtype=float)
    dial = 14 if width >= 52 else 0
    chart_width = width - dial - 1
    top = _top([np.hypot(nominal[:, 0], nominal[:, 1]), np.hypot(safe[:, 0], safe[:, 1])], 1.0)
    chart = _chart(
        chart_width,
        (0.0, top),
        times,
        ((np.hypot(nominal[:, 0], nominal[:, 1]), WARN), (np.hypot(safe[:, 0], safe[:, 1]), CALM)),
        rows=subject.chart_rows + 1,
    )
    if dial:
        picture = _dial(tick, dial, subject.chart_rows + 1, top)
        lines += [
            Strip([*one, Segment(" "), *two]) for one, two in zip(picture, chart, strict=True)
        ]
    else:
        lines += chart
    legend: Text = [(" " * dial, FAINT), ("  ▬ baseline", WARN), ("  ▬ safe", CALM)]
    lines.append([*legend, (f"  horizontal, last {CHART_S:.0f} s", FAINT)])
    return lines


def attitude_block(subject: VehicleSubject, width: int) -> list[Text | Strip]:
    """Return the attitude setpoint and the measured attitude, as numbers and as charts."""
    tick = subject.tick
    if tick is None:
        return [[(" no pipeline values heard yet", FAINT)]]
    setpoint, measured = (
        tick.setpoint_quaternion_enu_flu_wxyz,
        tick.attitude_quaternion_enu_flu_wxyz,
    )
    lines: list[Text | Strip] = [
        [(f"            {'roll':>7}{'pitch':>8}{'yaw':>8}{'thrust':>9}", FAINT)]
    ]
    for label, quaternion, thrust, colour in (
        ("setpoint", setpoint, f"{number(100 * tick.setpoint_thrust_frac, 0)} %", WARN),
        ("measured", measured, f"({number(100 * tick.hover_thrust_frac, 0)} % hovers)", CALM),
    ):
        angles = "".join(f"{number(angle, 1, sign=True):>7}°" for angle in euler_deg(quaternion))
        lines.append([(f" {label:<10}", FAINT), (angles, colour), (f"  {thrust}", TEXT)])
    times = _times(subject.tick_samples)
    series = [
        (
            np.array(
                [euler_deg(each.setpoint_quaternion_enu_flu_wxyz) for each in subject.tick_samples]
            ),
            WARN,
        ),
        (
            np.array(
                [euler_deg(each.attitude_quaternion_enu_flu_wxyz) for each in subject.tick_samples]
            ),
            CALM,
        ),
    ]
    top = _top([values[:, :2] for values, _ in series], 5.0)
    is_beside = width >= 60
    each_width = width // 2 if is_beside else width
    charts = [
        _chart(
            each_width,
            (-top, top),
            times,
            [(values[:, axis], colour) for values, colour in series],
            rows=subject.chart_rows,
        )
        for axis in (0, 1)
    ]
    if is_beside:
        lines.append([(f" {'roll, °':<{each_width - 1}} pitch, °", FAINT)])
        lines += [Strip([*one, *two]) for one, two in zip(*charts, strict=True)]
    else:
        for title, chart in zip(("roll", "pitch"), charts, strict=True):
            lines += [[(f" {title}, °", FAINT)], *chart]
    return lines


def euler_deg(quaternion_wxyz: Vec4) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in degrees of a rotation from body FLU to ENU; nan where there is
    none.

    The rotation is yaw, then pitch, then roll.
    """
    w, x, y, z = quaternion_wxyz
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not math.isfinite(norm) or norm < 1e-9:
        return (math.nan, math.nan, math.nan)
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return (math.degrees(roll), math.degrees(pitch), math.degrees(yaw))


def _vector(vector: Vec3) -> str:
    norm = math.sqrt(sum(axis * axis for axis in vector))
    return (
        "  ".join(f"{number(axis, 2, sign=True, limit=999):>6}" for axis in vector)
        + f"   |{number(norm, 2)}|"
    )


def _times(ticks: Sequence[TickSample]) -> Array:
    """Return the seconds (n,) since the newest tick, all negative or 0."""
    stamps = np.array([tick.stamp_ns for tick in ticks], dtype=np.int64)
    seconds: Array = (stamps - stamps[-1]) * 1e-9
    return seconds


def _top(values: Sequence[Array], least: float) -> float:
    """Return a round top of the scale for all of these."""
    most = max(
        (float(np.nanmax(np.abs(array))) for array in values if np.isfinite(array).any()),
        default=least,
    )
    return next(
        (
            step
            for step in (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 90.0)
            if step >= max(least, most)
        ),
        180.0,
    )


def _chart(
    width: int,
    limits: tuple[float, float],
    times: Array,
    series: Sequence[tuple[Array, str]],
    *,
    rows: int,
) -> list[Strip]:
    """Return lines over the last CHART_S seconds, the last of ``series`` on top; the scale at the
    left.
    """
    canvas = Canvas(width, rows)
    left, (low, high) = 12, limits
    columns, height = 2 * width - left - 1, 4 * rows - 1
    if columns < 8:
        return canvas.strips()
    for value in {low, 0.0, high}:
        row = height * (high - value) / (high - low)
        canvas.line((left, row), (2 * width, row), RULE, gap=4)
        canvas.text(0, min(rows - 1, int(row // 4)), f"{value:>5.0f}", FAINT)
    is_shown = times >= -CHART_S
    x = left + columns * (1.0 + times[is_shown] / CHART_S)
    for values, colour in series:
        y = height * (high - np.clip(values[is_shown], low, high)) / (high - low)
        # Between two samples the line is filled up, so that steep changes do not fall apart into
        # dots.
        fine = np.linspace(0, max(0, len(x) - 1), max(2, 4 * columns))
        if len(x) > 1:
            canvas.dots(
                np.interp(fine, np.arange(len(x)), x), np.interp(fine, np.arange(len(x)), y), colour
            )
    return canvas.strips()


def _dial(tick: TickSample, width: int, rows: int, top: float) -> list[Strip]:
    """Return nominal and safe thrust from above: north is up, the ring is the top of the scale."""
    canvas = Canvas(width, rows)
    middle = (width - 1.0, 2.0 * rows - 0.5)
    radius = min(middle) - 0.5
    canvas.circles(np.array([middle]), radius, RULE, gap=2)
    for vector, colour in (
        (tick.thrust_baseline_enu_m_s2, WARN),
        (tick.thrust_safe_enu_m_s2, CALM),
    ):
        end = (middle[0] + radius * vector[0] / top, middle[1] - radius * vector[1] / top)
        canvas.line(middle, end, colour)
    return canvas.strips()
