"""What ``covey identify`` says: a table against the fleet file, which differences matter, and the TOML to put in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from groundstation.identification.identify import Estimate, Identified
from onboard.config.fleet import Vehicle
from onboard.feasibility.bounds import LAG_ERROR_S

_HOVER_SHARE = 0.05  # of the hover throttle: what the observer makes good without being noticed
_DRAG_M_S2 = 0.15
_TILT_DEG, _GAIN = 2.0, 0.15


@dataclass(frozen=True, slots=True)
class Flown:
    """A vehicle as configured, and as it flew."""

    vehicle: Vehicle
    identified: Identified


def rows(flown: Flown) -> list[dict[str, Any]]:
    """One row for each parameter: what the file says, what was flown, and in words whether it matters."""
    vehicle, found = flown.vehicle, flown.identified
    tilt = math.hypot(found.tilt_error_x_deg.value, found.tilt_error_y_deg.value)
    judged = (
        (
            "hover_thrust_frac",
            vehicle.hover_thrust_frac,
            found.hover_thrust_frac,
            _HOVER_SHARE * vehicle.hover_thrust_frac,
            "take-off and height start off wrong until it is learned",
        ),
        (
            "lag L [s]",
            vehicle.lag_s,
            found.lag_s,
            LAG_ERROR_S,
            f"the law predicts over L and needs it to {1e3 * LAG_ERROR_S:.0f} ms to keep its distance",
        ),
        (
            "drag_1_s",
            vehicle.drag_1_s,
            found.drag_1_s,
            _DRAG_M_S2 / vehicle.max_speed_m_s,
            "the vehicle brakes later or earlier than the law believes",
        ),
        ("tilt error, east [deg]", 0.0, found.tilt_error_x_deg, _TILT_DEG, "trim the vehicle or level its autopilot"),
        ("tilt error, north [deg]", 0.0, found.tilt_error_y_deg, _TILT_DEG, "trim the vehicle or level its autopilot"),
        ("static gain", 1.0, found.static_gain, _GAIN, "the attitude loop is too weak: tune it"),
    )
    return [_row(*one, tilt) for one in judged]


def _row(name: str, said: float, found: Estimate, harmless: float, why: str, tilt_deg: float) -> dict[str, Any]:
    off = abs(found.value - said)
    if found.low <= said <= found.high:
        word = "agrees"
    elif off <= harmless:
        word = "differs, harmless"
    else:
        word = f"matters: {why}"
    if name.startswith("tilt") and word.startswith("differs"):
        word = f"lean of {tilt_deg:.1f} deg in all; the observer makes it good"
    return {
        "name": name,
        "fleet_file": round(said, 4),
        "value": round(found.value, 4),
        "std": round(found.std, 4),
        "low": round(found.low, 4),
        "high": round(found.high, 4),
        "verdict": word,
    }


def page(flown: Sequence[Flown]) -> str:
    """Tables of all vehicles, and one proposal for each type."""
    lines: list[str] = []
    for one in flown:
        found = one.identified
        lines.append(
            f"{one.vehicle.name} (type {one.vehicle.type or 'none'}), {found.duration_s:.0f} s in the air; attitude "
            f"explained to {found.attitude_rms_deg:.2f} deg, position to {1e3 * found.position_rms_m:.1f} mm rms"
        )
        lines.append(f"  {'':<24} {'fleet file':>10} {'flown':>9} {'1 sigma':>8}   95 % interval")
        for row in rows(one):
            interval = f"{row['low']:.3f} to {row['high']:.3f}"
            lines.append(
                f"  {row['name']:<24} {row['fleet_file']:>10.3f} {row['value']:>9.3f} {row['std']:>8.3f}   "
                f"{interval:<18} {row['verdict']}"
            )
        lines.append("")
    types: dict[str, list[Flown]] = {}
    for one in flown:
        types.setdefault(one.vehicle.type, []).append(one)
    for kind, members in types.items():
        lines += [proposal(kind, members), ""]
    return "\n".join(lines).rstrip()


def proposal(kind: str, members: Sequence[Flown]) -> str:
    """TOML for ``[types.KIND]``: means over the vehicles of the type that flew, with their intervals as comments."""
    who = ", ".join(one.vehicle.name for one in members)
    table = f"types.{kind}" if kind else "defaults"
    found = [one.identified for one in members]
    lag_s = _mean([one.lag_s for one in found])
    wn, zeta = _mean([one.wn_rad_s for one in found]), _mean([one.zeta for one in found])
    delay_s = lag_s.value - 2.0 * zeta.value / wn.value
    wn_rad_s = wn.value
    if delay_s < 0.0:  # the response is quicker than its own shape says: keep L, which is what the law uses
        delay_s, wn_rad_s = 0.0, 2.0 * zeta.value / max(lag_s.value, 0.01)
    hover, drag = _mean([one.hover_thrust_frac for one in found]), _mean([one.drag_1_s for one in found])
    gain = _mean([one.static_gain for one in found])
    lean = max(max(abs(one.tilt_error_x_deg.value), abs(one.tilt_error_y_deg.value)) for one in found)
    lines = [
        f"# identified from {who}; 95 % intervals of the mean",
        f"[{table}]",
        f"hover_thrust_frac = {hover.value:.3f}  # {hover.low:.3f} to {hover.high:.3f}",
        f"attitude_delay_s = {delay_s:.3f}  # L = delay + 2 zeta / wn = {lag_s.value:.3f} s, "
        f"{lag_s.low:.3f} to {lag_s.high:.3f}",
        f"attitude_wn_rad_s = {wn_rad_s:.2f}  # {wn.low:.2f} to {wn.high:.2f}",
        f"attitude_zeta = {min(max(zeta.value, 0.2), 2.0):.3f}  # {zeta.low:.3f} to {zeta.high:.3f}",
        f"drag_1_s = {max(drag.value, 0.0):.2f}  # {drag.low:.2f} to {drag.high:.2f}",
        "",
        f"[{table}.sitl]  # for the emulator only; the control has to cope without them",
        f"static_gain = {gain.value:.3f}  # {gain.low:.3f} to {gain.high:.3f}",
        f"tilt_bias_deg = {lean:.1f}",
    ]
    spread = [one.lag_s.value for one in found]
    if max(spread) - min(spread) > LAG_ERROR_S:
        lines.insert(1, "# their lags differ by more than the law tolerates: give each vehicle its own values instead")
    return "\n".join(lines)


def _mean(estimates: Sequence[Estimate]) -> Estimate:
    """Mean over vehicles; its interval covers the intervals' own width and the vehicles' spread."""
    count = len(estimates)
    value = sum(one.value for one in estimates) / count
    own = math.sqrt(sum(one.std**2 for one in estimates)) / count
    spread = math.sqrt(sum((one.value - value) ** 2 for one in estimates) / count)
    std = math.hypot(own, spread)
    half = std * max((one.high - one.value) / one.std for one in estimates)
    return Estimate(value, std, value - half, value + half)
