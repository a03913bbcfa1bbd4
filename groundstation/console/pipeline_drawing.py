"""Draws values of one vehicle's pipeline: thrust before and after OIST, and attitude. Pure.

OIST is the avoidance law: it turns the baseline thrust of the controller into a safe thrust. Each
value is drawn as numbers and as a chart over the last seconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from rich.segment import Segment
from textual.strip import Strip

from groundstation.console.canvas import DOTS_ACROSS, DOTS_DOWN, Canvas
from groundstation.console.theme import CALM, FAINT, RULE, TEXT, WARN, clean, number
from groundstation.console.vehicle_subject import Text, VehicleSubject
from onboard.arrays import Array
from onboard.bus.schema import TickSample
from onboard.tuples import Wxyz, Xyz

CHART_S = 20.0
_SCALE_TOPS = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 90.0)  # round largest values
_HIGHEST_TOP = 180.0  # largest value of a scale if none of these is large enough
_DIAL_WIDTH = 14  # cells
_WIDTH_WITH_DIAL = 52  # cells from which the dial is drawn beside the chart
_WIDTH_SIDE_BY_SIDE = 60  # cells from which roll and pitch are drawn side by side
_HELD_BACK_M_S2 = 0.01  # smallest intervention that is shown
_SCALE_DOTS = 12  # width of a chart's scale at its left
_MIN_COLUMNS = 8  # dots below which a chart is not drawn
_NO_ROTATION = 1e-9  # norm of a quaternion below which it is not a rotation


def thrust_block(subject: VehicleSubject, width: int) -> list[Text | Strip]:
    """Return the thrust before and after OIST, as numbers and as a chart."""
    tick = subject.tick
    if tick is None:
        return [[(" no pipeline values heard yet", FAINT)]]

    lines: list[Text | Strip] = [
        [(" baseline   ", FAINT), (_vector(tick.thrust_baseline_enu_m_s2), WARN)],
        [(" safe       ", FAINT), (_vector(tick.thrust_safe_enu_m_s2), CALM)],
        _held_back(tick),
    ]

    baseline_m_s2 = _horizontal_norms(
        [sample.thrust_baseline_enu_m_s2 for sample in subject.tick_samples]
    )
    safe_m_s2 = _horizontal_norms([sample.thrust_safe_enu_m_s2 for sample in subject.tick_samples])
    top_m_s2 = _top([baseline_m_s2, safe_m_s2], 1.0)

    dial_width = _DIAL_WIDTH if width >= _WIDTH_WITH_DIAL else 0
    rows = subject.chart_rows + 1
    chart = _chart(
        width - dial_width - 1,
        (0.0, top_m_s2),
        _times(subject.tick_samples),
        ((baseline_m_s2, WARN), (safe_m_s2, CALM)),
        rows=rows,
    )
    if dial_width:
        dial = _dial(tick, dial_width, rows, top_m_s2)
        for left, right in zip(dial, chart, strict=True):
            lines.append(Strip([*left, Segment(" "), *right]))
    else:
        lines += chart

    legend: Text = [(" " * dial_width, FAINT), ("  ▬ baseline", WARN), ("  ▬ safe", CALM)]
    lines.append([*legend, (f"  horizontal, last {CHART_S:.0f} s", FAINT)])
    return lines


def _held_back(tick: TickSample) -> Text:
    """Return the line about the part of the thrust that the law takes away."""
    held_m_s2 = tick.intervention_m_s2
    is_held = math.isfinite(held_m_s2) and held_m_s2 > _HELD_BACK_M_S2
    if not is_held:
        return [(" held back  ", FAINT), ("nothing: it passes unchanged", FAINT)]

    neighbour = ""
    if tick.active_neighbour:
        neighbour = f" for {clean(tick.active_neighbour, 24)}"
    words = f"{number(held_m_s2, 2)}{neighbour}, {clean(tick.law_status, 16)}"
    return [(" held back  ", FAINT), (words, CALM)]


def _horizontal_norms(vectors: Sequence[Xyz]) -> Array:
    """Return the horizontal norm (n,) of each vector."""
    horizontal = np.array([vector[:2] for vector in vectors], dtype=float)
    norms: Array = np.hypot(horizontal[:, 0], horizontal[:, 1])
    return norms


def attitude_block(subject: VehicleSubject, width: int) -> list[Text | Strip]:
    """Return the attitude setpoint and the measured attitude, as numbers and as charts."""
    tick = subject.tick
    if tick is None:
        return [[(" no pipeline values heard yet", FAINT)]]

    thrust = f"{number(100 * tick.setpoint_thrust_frac, 0)} %"
    hover_thrust = f"({number(100 * tick.hover_thrust_frac, 0)} % hovers)"
    lines: list[Text | Strip] = [
        [(f"            {'roll':>7}{'pitch':>8}{'yaw':>8}{'thrust':>9}", FAINT)],
        [
            (" setpoint  ", FAINT),
            (_angles(tick.setpoint_quaternion_enu_flu_wxyz), WARN),
            (f"  {thrust}", TEXT),
        ],
        [
            (" measured  ", FAINT),
            (_angles(tick.attitude_quaternion_enu_flu_wxyz), CALM),
            (f"  {hover_thrust}", TEXT),
        ],
    ]

    samples = subject.tick_samples
    setpoints_deg = np.array(
        [euler_deg(sample.setpoint_quaternion_enu_flu_wxyz) for sample in samples]
    )
    measured_deg = np.array(
        [euler_deg(sample.attitude_quaternion_enu_flu_wxyz) for sample in samples]
    )
    top_deg = _top([setpoints_deg[:, :2], measured_deg[:, :2]], 5.0)

    is_side_by_side = width >= _WIDTH_SIDE_BY_SIDE
    chart_width = width // 2 if is_side_by_side else width
    roll_chart, pitch_chart = (
        _chart(
            chart_width,
            (-top_deg, top_deg),
            _times(samples),
            [(setpoints_deg[:, axis], WARN), (measured_deg[:, axis], CALM)],
            rows=subject.chart_rows,
        )
        for axis in (0, 1)
    )

    if is_side_by_side:
        lines.append([(f" {'roll, °':<{chart_width - 1}} pitch, °", FAINT)])
        for left, right in zip(roll_chart, pitch_chart, strict=True):
            lines.append(Strip([*left, *right]))
    else:
        lines += [[(" roll, °", FAINT)], *roll_chart]
        lines += [[(" pitch, °", FAINT)], *pitch_chart]
    return lines


def euler_deg(quaternion_wxyz: Wxyz) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in degrees of a rotation from body FLU to ENU.

    The rotation is yaw, then pitch, then roll. All three are NaN if the quaternion is not a
    rotation.
    """
    w, x, y, z = quaternion_wxyz
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not math.isfinite(norm) or norm < _NO_ROTATION:
        return (math.nan, math.nan, math.nan)
    w /= norm
    x /= norm
    y /= norm
    z /= norm

    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return (math.degrees(roll), math.degrees(pitch), math.degrees(yaw))


def _angles(quaternion_wxyz: Wxyz) -> str:
    return "".join(f"{number(angle, 1, sign=True):>7}°" for angle in euler_deg(quaternion_wxyz))


def _vector(vector: Xyz) -> str:
    axes = "  ".join(f"{number(axis, 2, sign=True, limit=999):>6}" for axis in vector)
    norm = math.sqrt(sum(axis * axis for axis in vector))
    return f"{axes}   |{number(norm, 2)}|"


def _times(ticks: Sequence[TickSample]) -> Array:
    """Return the seconds (n,) since the newest tick, all negative or 0."""
    stamps_ns = np.array([tick.stamp_ns for tick in ticks], dtype=np.int64)
    seconds: Array = (stamps_ns - stamps_ns[-1]) * 1e-9
    return seconds


def _top(values: Sequence[Array], least: float) -> float:
    """Return a round largest value of a scale for all of these values; at least `least`."""
    most = least
    finite = [array for array in values if np.isfinite(array).any()]
    if finite:
        most = max(float(np.nanmax(np.abs(array))) for array in finite)

    for top in _SCALE_TOPS:
        if top >= max(least, most):
            return top
    return _HIGHEST_TOP


def _chart(
    width: int,
    limits: tuple[float, float],
    times: Array,
    series: Sequence[tuple[Array, str]],
    *,
    rows: int,
) -> list[Strip]:
    """Return a chart of the last CHART_S seconds, with its scale at the left.

    Args:
        width: width in cells.
        limits: least and greatest value of the scale.
        times: times (n,) from the newest value, 0 or negative [s].
        series: values (n,) and colour of each curve; the last one is drawn on top.
        rows: height in cells.
    """
    canvas = Canvas(width, rows)
    columns = DOTS_ACROSS * width - _SCALE_DOTS - 1
    height = DOTS_DOWN * rows - 1
    if columns < _MIN_COLUMNS:
        return canvas.strips()

    low, high = limits
    for value in {low, 0.0, high}:
        row = height * (high - value) / (high - low)
        canvas.line((_SCALE_DOTS, row), (DOTS_ACROSS * width, row), RULE, gap=4)
        canvas.text(0, min(rows - 1, int(row // DOTS_DOWN)), f"{value:>5.0f}", FAINT)

    is_shown = times >= -CHART_S
    x = _SCALE_DOTS + columns * (1.0 + times[is_shown] / CHART_S)
    if len(x) < 2:
        return canvas.strips()

    # Values between the samples are interpolated, so that steep changes are lines and not dots.
    samples = np.arange(len(x))
    fine = np.linspace(0, len(x) - 1, 4 * columns)
    for values, colour in series:
        y = height * (high - np.clip(values[is_shown], low, high)) / (high - low)
        canvas.dots(np.interp(fine, samples, x), np.interp(fine, samples, y), colour)
    return canvas.strips()


def _dial(tick: TickSample, width: int, rows: int, top_m_s2: float) -> list[Strip]:
    """Return baseline and safe thrust as lines, seen from above, with north up.

    A thrust of ``top_m_s2`` reaches the ring.
    """
    canvas = Canvas(width, rows)
    middle_x = width - 1.0  # in dots
    middle_y = 2.0 * rows - 0.5
    radius = min(middle_x, middle_y) - 0.5
    canvas.circles(np.array([(middle_x, middle_y)]), radius, RULE, gap=2)

    vectors = (
        (tick.thrust_baseline_enu_m_s2, WARN),
        (tick.thrust_safe_enu_m_s2, CALM),
    )
    for (east_m_s2, north_m_s2, _), colour in vectors:
        x = middle_x + radius * east_m_s2 / top_m_s2
        y = middle_y - radius * north_m_s2 / top_m_s2
        canvas.line((middle_x, middle_y), (x, y), colour)
    return canvas.strips()
