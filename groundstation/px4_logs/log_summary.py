"""Summarises a PX4 log, and a flight's logs on one clock, in lines for a terminal. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from groundstation.px4_logs.alignment import flu_of_frd, up_in_body
from groundstation.px4_logs.flight_logs import FlightLog, FoundLogs
from groundstation.px4_logs.px4_log import LoggedText, LogRows, Px4Log

_MB = 1e6
_MAX_LINES = 30  # most messages or mode changes listed for one log
_SERIOUS = ("error", "warning")

# Flight modes by vehicle_status.nav_state.
_MODES = {
    0: "Manual",
    1: "Altitude",
    2: "Position",
    3: "Mission",
    4: "Hold",
    5: "Return",
    10: "Acro",
    12: "Descend",
    13: "Termination",
    14: "Offboard",
    15: "Stabilized",
    17: "Takeoff",
    18: "Land",
    21: "Orbit",
}


def as_mapping(log: Px4Log) -> dict[str, Any]:
    """Return a log's summary as data for programs; times are seconds since PX4's start."""
    return {
        "path": log.path,
        "size_bytes": log.size_bytes,
        "begin_s": log.begin_s,
        "length_s": log.length_s,
        "armed_s": log.armed_s,
        "about": log.about,
        "parameters": log.parameter_count,
        "dropout_s": log.dropout_s,
        "note": log.note,
        "modes": [[time_s, mode] for time_s, mode in modes(log.status)],
        "texts": [list(text) for text in log.texts],
    }


def lines(log: Px4Log) -> list[str]:
    """Return a log's summary as lines for one screen."""
    about = ", ".join(f"{key} {value}" for key, value in log.about.items())
    summary = [
        f"{log.path}: {log.length_s:.1f} s, armed for {log.armed_s:.1f} s, "
        f"{log.size_bytes / _MB:.1f} MB, from {log.begin_s:.1f} s after PX4's start.",
        f"{about or 'The file does not say of what'}; {log.parameter_count} parameters.",
    ]
    summary += [sentence for sentence in (log.note, _dropouts(log)) if sentence]
    summary.append(f"{'topic':28s} {'samples':>8s} {'a second':>9s}")
    for name, rows in (
        ("attitude", log.attitude),
        ("attitude setpoint", log.attitude_setpoint),
        ("position", log.position),
        ("position setpoint", log.position_setpoint),
        ("battery", log.battery),
        ("status", log.status),
    ):
        rate_hz = rows.size / max(log.length_s, 1e-3)
        summary.append(f"{name:28s} {rows.size:8d} {rate_hz:9.1f}")

    summary += _flight_lines(log)
    changes = [f"{mode} from {time_s - log.begin_s:.1f} s" for time_s, mode in modes(log.status)]
    if changes:
        summary.append(f"Modes: {', '.join(changes[:_MAX_LINES])}.")
    summary += _message_lines(log.texts, log.begin_s)
    return summary


def _dropouts(log: Px4Log) -> str:
    if not log.dropout_s:
        return ""
    return f"Its card was too slow: {log.dropout_s:.1f} s in all are missing."


def _flight_lines(log: Px4Log) -> list[str]:
    """Return lines on the largest height, speed and tilt, and on the battery."""
    summary = []
    if log.position.size:
        _, _, down_m, north_m_s, east_m_s, *_ = log.position.values.T
        with np.errstate(all="ignore"):
            speed_m_s = np.hypot(north_m_s, east_m_s)
        height_m = _most(-down_m)
        parts = [f"highest {height_m:.1f} m", f"fastest {_most(speed_m_s):.1f} m/s"]

        if log.attitude.size:
            up = up_in_body(flu_of_frd(log.attitude.values))
            tilt_deg = np.degrees(np.arccos(np.clip(up[:, 2], -1.0, 1.0)))
            parts.append(f"tilted up to {_most(tilt_deg):.0f} deg")
        summary.append(f"By PX4's own estimate: {', '.join(parts)}.")

    if log.battery.size:
        voltage_v, frac = log.battery.values.T
        summary.append(
            f"Battery: {_first(voltage_v):.1f} V to {_least(voltage_v):.1f} V,"
            f" {100.0 * _first(frac):.0f} % to {100.0 * _least(frac):.0f} %."
        )
    return summary


def _message_lines(texts: Iterable[LoggedText], begin_s: float) -> list[str]:
    """Return lines on PX4's messages: their number, and the warnings and errors among them."""
    texts = list(texts)
    serious = [text for text in texts if text.level in _SERIOUS]
    if not serious:
        return [f"PX4 said {len(texts)} lines, none of them a warning."]
    summary = [f"PX4 said {len(texts)} lines, of which {len(serious)} are warnings or errors:"]
    for text in serious[:_MAX_LINES]:
        summary.append(f"  {text.time_s - begin_s:8.2f} s  {text.level:8s} {text.text}")
    if len(serious) > _MAX_LINES:
        summary.append(f"  and {len(serious) - _MAX_LINES} more.")
    return summary


def fleet_lines(found: FoundLogs) -> list[str]:
    """Return a summary of a flight's logs; times are seconds since the record's start."""
    if not found.logs and not found.notes:
        return []
    summary = ["PX4's own logs, on the record's clock:"]
    if found.logs:
        summary.append(
            f"{'vehicle':16s} {'from':>8s} {'to':>8s} {'battery':>14s} {'warnings':>9s}"
            f" {'tilt differs':>13s} {'place differs':>14s}"
        )
    summary += [_fleet_line(log) for log in found.logs.values()]
    summary += list(found.notes)
    return summary + _timeline(found.logs.values())


def fleet_mapping(found: FoundLogs) -> dict[str, Any]:
    """Return the summary of a flight's logs as data for programs."""
    return {
        "logs": {
            name: {
                **as_mapping(flight_log.log),
                "offset_s": flight_log.alignment.offset_s,
                "drift_ppm": 1e6 * flight_log.alignment.drift_frac,
                "residual_deg": flight_log.alignment.residual_deg,
                "position_residual_m": flight_log.position_residual_m,
            }
            for name, flight_log in found.logs.items()
        },
        "left_out": list(found.notes),
    }


def _fleet_line(flight_log: FlightLog) -> str:
    battery = "not logged"
    if flight_log.log.battery.size:
        frac = flight_log.log.battery.values[:, 1]
        battery = f"{100.0 * _first(frac):.0f} to {100.0 * _least(frac):.0f} %"
    warnings = sum(text.level in _SERIOUS for text in flight_log.log.texts)
    place = "not known"
    if np.isfinite(flight_log.position_residual_m):
        place = f"{flight_log.position_residual_m:.2f} m"
    return (
        f"{flight_log.vehicle:16s} {flight_log.begin_s:8.1f} {flight_log.end_s:8.1f}"
        f" {battery:>14s} {warnings:9d}"
        f" {flight_log.alignment.residual_deg:9.2f} deg {place:>14s}"
    )


def _timeline(logs: Iterable[FlightLog]) -> list[str]:
    """Return lines about warnings, errors and mode changes of all vehicles, in order of time."""
    events: list[tuple[float, str]] = []
    for log in logs:
        for time_s, mode in modes(log.log.status):
            events.append((log.on_record_s(time_s), f"{log.vehicle:16s} mode     {mode}"))
        for text in log.texts:
            if text.level in _SERIOUS:
                events.append((text.time_s, f"{log.vehicle:16s} {text.level:8s} {text.text}"))
    events.sort()
    most_lines = 2 * _MAX_LINES
    timeline = [f"{time_s:9.2f} s  {words}" for time_s, words in events[:most_lines]]
    if len(events) > most_lines:
        timeline.append(f"and {len(events) - most_lines} lines more.")
    return timeline


def modes(status: LogRows) -> list[tuple[float, str]]:
    """Return the times [s] at which PX4's mode changed, each with the new mode."""
    changes: list[tuple[float, str]] = []
    last_mode = ""
    _, nav_states, *_ = status.values.T
    for time_s, state in zip(status.time_s.tolist(), nav_states.tolist(), strict=True):
        mode = "not known"  # of a state that is NaN, since it was damaged
        if not np.isnan(state):
            mode = _MODES.get(int(state), f"mode {int(state)}")
        if mode != last_mode:
            changes.append((time_s, mode))
        last_mode = mode
    return changes


def _most(values: Any) -> float:
    """Return the largest finite value; 0 without any."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0
    return float(known.max())


def _least(values: Any) -> float:
    """Return the smallest finite value; 0 without any."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0
    return float(known.min())


def _first(values: Any) -> float:
    """Return the first finite value; 0 without any."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0
    return float(known[0])
