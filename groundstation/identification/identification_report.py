"""The report of ``covey identify``: flown parameters beside the fleet file's, and TOML for it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from groundstation.identification.identify import Estimate, Identified
from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config.fleet import Vehicle
from onboard.config.validation import VEHICLE_BOUNDS

# differences up to these are harmless
_HOVER_SHARE = 0.05  # share of the hover thrust, which the observer compensates
_DRAG_M_S2 = 0.15  # deceleration by drag at top speed
_TILT_DEG = 2.0
_GAIN = 0.15
_DRAG_KNOWN_1_S = 0.06  # half of drag's interval after a long flight in calm air
_NOT_KNOWN = "not known well enough: fly longer"
_WRITTEN_LAG_ERROR_S = 0.001  # the values are written with three decimals
# the values of a vehicle, and those of its emulator, for which there is TOML
_KEYS = {"hover_thrust_frac", "attitude_delay_s", "attitude_wn_rad_s", "attitude_zeta", "drag_1_s"}
_SITL_KEYS = {"static_gain", "tilt_bias_deg"}


@dataclass(frozen=True, slots=True)
class IdentifiedVehicle:
    """A vehicle of the fleet file, and the parameters with which it flew."""

    vehicle: Vehicle
    identified: Identified
    has_own_values: bool = False  # whether its own table sets such values, and not only its type


def sets_values(own_table: Mapping[str, Any]) -> bool:
    """Return whether the table of a vehicle, ``[vehicles.NAME]``, sets a value to identify."""
    sitl_table = own_table.get("sitl", {})
    return not (_KEYS.isdisjoint(own_table) and _SITL_KEYS.isdisjoint(sitl_table))


def rows(flown: IdentifiedVehicle) -> list[dict[str, Any]]:
    """Compare each parameter of the fleet file with the flown one.

    Args:
        flown: the vehicle.

    Returns:
        A row for each parameter, with a verdict in words.
    """
    vehicle = flown.vehicle
    identified = flown.identified
    east_deg = identified.tilt_error_x_deg
    north_deg = identified.tilt_error_y_deg
    weak_or_strong = "weak" if identified.static_gain.value < 1.0 else "strong"

    table = [
        _row(
            "hover_thrust_frac",
            configured=vehicle.hover_thrust_frac,
            flown=identified.hover_thrust_frac,
            harmless=_HOVER_SHARE * vehicle.hover_thrust_frac,
            reason="take-off and height start off wrong until it is learned",
        ),
        _row(
            "lag L [s]",
            configured=vehicle.lag_s,
            flown=identified.lag_s,
            harmless=LAG_ERROR_S,
            reason=f"the law predicts over L and needs it to {1e3 * LAG_ERROR_S:.0f} ms to keep "
            "its distance",
        ),
        _row(
            "drag_1_s",
            configured=vehicle.drag_1_s,
            flown=identified.drag_1_s,
            harmless=_DRAG_M_S2 / vehicle.max_speed_m_s,
            half_width=max(_DRAG_M_S2 / vehicle.max_speed_m_s, _DRAG_KNOWN_1_S),
            reason="the vehicle brakes later or earlier than the law believes",
        ),
        _row(
            "tilt error, east [deg]",
            configured=0.0,
            flown=east_deg,
            harmless=_TILT_DEG,
            reason="trim the vehicle or level its autopilot",
        ),
        _row(
            "tilt error, north [deg]",
            configured=0.0,
            flown=north_deg,
            harmless=_TILT_DEG,
            reason="trim the vehicle or level its autopilot",
        ),
        _row(
            "static gain",
            configured=1.0,
            flown=identified.static_gain,
            harmless=_GAIN,
            reason=f"the attitude loop is too {weak_or_strong}: tune it",
        ),
    ]

    # the two tilt errors together, if they are harmless
    tilt_deg = math.hypot(east_deg.value, north_deg.value)
    for row in table:
        if row["name"].startswith("tilt") and row["verdict"].startswith("differs"):
            row["verdict"] = f"tilted by {tilt_deg:.1f} deg in all; the observer compensates it"
    return table


def unknown_parameters(flown: IdentifiedVehicle) -> list[str]:
    """Return the names of the parameters whose intervals are too wide to rely on the values."""
    return [row["name"] for row in rows(flown) if not row["is_known"]]


def _row(
    name: str,
    *,
    configured: float,
    flown: Estimate,
    harmless: float,
    half_width: float | None = None,
    reason: str,
) -> dict[str, Any]:
    """Return the row of one parameter.

    Args:
        name: name of the parameter.
        configured: value of the fleet file.
        flown: value of the flight.
        harmless: a difference up to this has no noticeable effect.
        half_width: half of the widest interval of a value that is known; None: ``harmless``.
        reason: what a larger difference means, in words.
    """
    if half_width is None:
        half_width = harmless
    is_known = 0.5 * (flown.high - flown.low) <= half_width

    if flown.low <= configured <= flown.high:
        word = "agrees" if is_known else _NOT_KNOWN
    elif abs(flown.value - configured) <= harmless:
        word = "differs, harmless"
    else:
        word = f"matters: {reason}"
    return {
        "name": name,
        "fleet_file": round(configured, 4),
        "value": round(flown.value, 4),
        "std": round(flown.std, 4),
        "low": round(flown.low, 4),
        "high": round(flown.high, 4),
        "is_known": is_known,
        "verdict": word,
    }


def page(flown: Sequence[IdentifiedVehicle]) -> str:
    """Return tables of all vehicles, and TOML for the fleet file."""
    lines: list[str] = []
    for member in flown:
        vehicle = member.vehicle
        identified = member.identified
        lines.append(
            f"{vehicle.name} (type {vehicle.type or 'none'}), {identified.duration_s:.0f} s of "
            f"flight used; attitude explained to {identified.attitude_rms_deg:.2f} deg, position "
            f"to {1e3 * identified.position_rms_m:.1f} mm rms"
        )
        lines.append(f"  {'':<24} {'fleet file':>10} {'flown':>9} {'1 sigma':>8}   95 % interval")
        for row in rows(member):
            interval = f"{row['low']:.3f} to {row['high']:.3f}"
            lines.append(
                f"  {row['name']:<24} {row['fleet_file']:>10.3f} {row['value']:>9.3f} "
                f"{row['std']:>8.3f}   {interval:<18} {row['verdict']}"
            )
        lines.append("")
    return "\n".join([*lines, "\n\n".join(tomls(flown))])


def tomls(flown: Sequence[IdentifiedVehicle]) -> list[str]:
    """Return TOML for the fleet file: one text for each flown type, or for single vehicles.

    A vehicle whose own table sets such values has its text, because they take precedence over its
    type's. Vehicles of a type whose lags differ by more than the law tolerates have one each.
    """
    types: dict[str, list[IdentifiedVehicle]] = {}
    for member in flown:
        types.setdefault(member.vehicle.type, []).append(member)

    texts: list[str] = []
    for kind, members in types.items():
        alike = [member for member in members if not member.has_own_values]
        lags_s = [member.identified.lag_s.value for member in alike]
        if alike and max(lags_s) - min(lags_s) > LAG_ERROR_S:
            texts.append(
                f"# the lags of {_names(alike)} differ by more than the law tolerates: each has its"
                " own values"
            )
            alike = []

        if alike:
            texts.append(table_toml(f"types.{kind}" if kind else "defaults", alike))
        for member in members:
            if member not in alike:
                texts.append(table_toml(f"vehicles.{member.vehicle.name}", [member]))
    return texts


def _names(members: Sequence[IdentifiedVehicle]) -> str:
    return ", ".join(member.vehicle.name for member in members)


def table_toml(table: str, members: Sequence[IdentifiedVehicle]) -> str:
    """Return TOML for a table: means over its vehicles, their intervals as comments."""
    models = [member.identified for member in members]
    lag_s = _mean([model.lag_s for model in models])
    wn = _mean([model.wn_rad_s for model in models])
    zeta = _mean([model.zeta for model in models])
    hover = _mean([model.hover_thrust_frac for model in models])
    drag = _mean([model.drag_1_s for model in models])
    gain = _mean([model.static_gain for model in models])

    # the largest tilt error of all vehicles about either axis
    tilt_deg = 0.0
    for model in models:
        for tilt in (model.tilt_error_x_deg, model.tilt_error_y_deg):
            tilt_deg = max(tilt_deg, abs(tilt.value))

    delay_s, wn_rad_s, written_zeta = _within_bounds(lag_s.value, wn.value, zeta.value)
    written_lag_s = delay_s + 2.0 * written_zeta / wn_rad_s

    lines = [
        f"# identified from {_names(members)}; 95 % intervals of the mean",
        f"[{table}]",
        f"hover_thrust_frac = {hover.value:.3f}  # {hover.low:.3f} to {hover.high:.3f}",
        f"attitude_delay_s = {delay_s:.3f}  # L = delay + 2 zeta / wn = {lag_s.value:.3f} s, "
        f"{lag_s.low:.3f} to {lag_s.high:.3f}",
        f"attitude_wn_rad_s = {wn_rad_s:.2f}  # {wn.low:.2f} to {wn.high:.2f}",
        f"attitude_zeta = {written_zeta:.3f}  # {zeta.low:.3f} to {zeta.high:.3f}",
        f"drag_1_s = {max(drag.value, 0.0):.2f}  # {drag.low:.2f} to {drag.high:.2f}",
        "",
        f"[{table}.sitl]  # for the emulator only; the control has to cope without them",
        f"static_gain = {gain.value:.3f}  # {gain.low:.3f} to {gain.high:.3f}",
        f"tilt_bias_deg = {tilt_deg:.1f}",
    ]

    if abs(written_lag_s - lag_s.value) > _WRITTEN_LAG_ERROR_S:
        lines.insert(
            1,
            f"# the bounds of the fleet file's values allow no L of {lag_s.value:.3f} s; these "
            f"values have one of {written_lag_s:.3f} s",
        )
    return "\n".join(lines)


def _within_bounds(lag_s: float, wn_rad_s: float, zeta: float) -> tuple[float, float, float]:
    """Return delay [s], wn [rad/s] and zeta within the bounds of the fleet file.

    Together they have the lag L, because the law uses only L. Each value is limited in turn, and
    the next ones make up for it. Where the bounds do not allow L, theirs is the nearest one.
    """
    zeta = _bounded("attitude_zeta", zeta)
    wn_rad_s = _bounded("attitude_wn_rad_s", wn_rad_s)
    delay_s = _bounded("attitude_delay_s", lag_s - 2.0 * zeta / wn_rad_s)

    # a limited delay leaves another part of L to the response, which is 2 zeta / wn
    response_s = max(lag_s - delay_s, 0.001)
    wn_rad_s = _bounded("attitude_wn_rad_s", 2.0 * zeta / response_s)
    zeta = _bounded("attitude_zeta", 0.5 * wn_rad_s * response_s)
    return delay_s, wn_rad_s, zeta


def _bounded(key: str, value: float) -> float:
    """Return a value limited to the bounds of its key in a vehicle's table."""
    low, high = VEHICLE_BOUNDS[key]
    return min(max(value, low), high)


def _mean(estimates: Sequence[Estimate]) -> Estimate:
    """Return the mean over vehicles.

    Its interval covers the vehicles' own intervals, and their differences.
    """
    count = len(estimates)
    value = sum(estimate.value for estimate in estimates) / count
    own_std = math.sqrt(sum(estimate.std**2 for estimate in estimates)) / count
    spread = math.sqrt(sum((estimate.value - value) ** 2 for estimate in estimates) / count)
    std = math.hypot(own_std, spread)
    widths_in_std = [(estimate.high - estimate.value) / estimate.std for estimate in estimates]
    half_width = std * max(widths_in_std)
    return Estimate(value=value, std=std, low=value - half_width, high=value + half_width)
