"""What each PX4 says of itself: version, board, uptime, state, sensors and links."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from groundstation.client.autopilot_link import AutopilotLink
from groundstation.px4.vehicle_links import VehicleLink
from groundstation.px4.vehicle_parameters import status_of
from onboard.autopilot import MEASURED_VERSIONS, Landed, Snapshot, plausible_version
from onboard.config.fleet import Vehicle
from onboard.exit_status import EXIT_NO_ANSWER
from onboard.px4 import modes
from onboard.px4.message_parsers import PARSERS
from onboard.px4.sensor_status import sensors

_LISTEN_S = 2.5
_AUTOPILOT_VERSION = 148
_WIDTH = 118
_KINDS = {0: "development", 64: "alpha", 128: "beta", 192: "release candidate", 255: "release"}
_FIXES = {
    0: "no receiver",
    1: "no fix",
    2: "2D fix",
    3: "3D fix",
    4: "3D fix, differential",
    5: "RTK float",
    6: "RTK",
}


@dataclass(frozen=True, slots=True)
class VehicleInfo:
    """Facts about one vehicle, by subject; ``trouble`` when nothing was heard."""

    name: str
    facts: dict[str, str] = field(default_factory=dict)
    trouble: str = ""


@dataclass(slots=True)
class _Traffic:
    """Messages of one link."""

    count: int = 0
    is_signed: bool = False

    def take(self, message: Any) -> None:
        self.count += 1
        self.is_signed |= bool(message.get_signed())


def ask(link: VehicleLink, key: bytes | None = None) -> VehicleInfo:
    """Listen to one vehicle for some seconds.

    Args:
        link: to its PX4.
        key: of its MAVLink signing, where its messages are signed.
    """
    if link.link is None:
        return VehicleInfo(link.vehicle.name, trouble=link.trouble)
    traffic = _Traffic()
    heard = link.link.listen(_LISTEN_S, [_AUTOPILOT_VERSION], take=traffic.take)
    facts = {
        "version": _version(link, heard),
        "board": _board(heard),
        "uptime": _uptime(heard),
        "state": _state(heard),
        "sensors": _sensors(heard),
        "satellites": _satellites(heard),
        "links": _links(link, traffic, key),
    }
    if key is not None:
        facts["signing"] = "it signs with the key of this vehicle, and so does Covey."
    elif traffic.is_signed:
        facts["signing"] = (
            "it has a key of MAVLink signing and ignores what is not signed, and mavlink_signing is not true in the "
            "fleet file: Covey cannot fly it."
        )
    return VehicleInfo(link.vehicle.name, facts)


def _version(link: VehicleLink, heard: dict[str, Any]) -> str:
    message, version = heard.get("AUTOPILOT_VERSION"), link.version
    if message is None or version is None:
        return "PX4 does not say its version"
    if plausible_version(version) is None:
        return link.version_text
    number = message.flight_sw_version
    commit = bytes(message.flight_custom_version)[::-1].hex()
    oldest, newest = MEASURED_VERSIONS
    known = "" if oldest <= version <= newest else ", never measured with Covey"
    kind = _KINDS.get(number & 0xFF, f"type {number & 0xFF}")
    return f"{link.version_text}.{number >> 8 & 0xFF}, {kind}, commit {commit}{known}"


def _board(heard: dict[str, Any]) -> str:
    message = heard.get("AUTOPILOT_VERSION")
    if message is None:
        return "not said"
    return (
        f"type {message.board_version >> 16}, vendor {message.vendor_id:04x}, product {message.product_id:04x}, "
        f"serial {message.uid:016x}"
    )


def _uptime(heard: dict[str, Any]) -> str:
    times = [message.time_boot_ms for message in heard.values() if hasattr(message, "time_boot_ms")]
    if not times:
        return "not said"
    minutes, seconds = divmod(max(times) // 1000, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min {seconds} s"


def _snapshot(heard: dict[str, Any], *names: str) -> Snapshot:
    changes: dict[str, Any] = {}
    for name in names:
        if name in heard:
            changes |= PARSERS[name](heard[name].to_dict(), 1)
    return Snapshot(**changes)


def _state(heard: dict[str, Any]) -> str:
    known = _snapshot(heard, "HEARTBEAT", "EXTENDED_SYS_STATE", "BATTERY_STATUS")
    words = ["armed" if known.is_armed else "disarmed", known.mode or "mode not said"]
    if known.landed is not Landed.UNKNOWN:
        words.append(known.landed.name.lower().replace("_", " "))
    if known.battery_ns:
        words.append(f"battery {known.battery_frac:.0%}, {known.battery_voltage_v:.1f} V")
    if "HEARTBEAT" in heard and heard["HEARTBEAT"].system_status == modes.STATUS_CRITICAL:
        words.append("in a failsafe")
    return ", ".join(words)


def _sensors(heard: dict[str, Any]) -> str:
    if "SYS_STATUS" not in heard:
        return "not said"
    known = sensors(_snapshot(heard, "SYS_STATUS"))
    unhealthy = ", ".join(name for name, is_healthy in known if not is_healthy)
    healthy = ", ".join(name for name, is_healthy in known if is_healthy)
    return f"healthy: {healthy or 'none'}; unhealthy: {unhealthy or 'none'}"


def _satellites(heard: dict[str, Any]) -> str:
    message = heard.get("GPS_RAW_INT")
    if message is None:
        return "no receiver reports"
    return f"{_FIXES.get(message.fix_type, f'fix {message.fix_type}')}, {message.satellites_visible} satellites"


def _links(link: VehicleLink, traffic: _Traffic, key: bytes | None) -> str:
    assert link.link is not None
    vehicle = link.vehicle
    parts = [f"{link.endpoint}: {traffic.count / _LISTEN_S:.0f} messages/s"]
    if link.endpoint == vehicle.autopilot:
        parts.append(_direct(vehicle, key))
    else:
        parts += link.silent_links
    return "; ".join(part.rstrip(".") for part in parts)


def _direct(vehicle: Vehicle, key: bytes | None) -> str:
    if vehicle.direct is None:
        return "no direct link in the fleet file"
    try:
        ground = AutopilotLink(vehicle.direct, vehicle.system_id, key=key)
    except (OSError, ValueError) as error:
        return f"{vehicle.direct}: {error}"
    try:
        return f"{vehicle.direct}: {'answers' if ground.is_armed() is not None else 'silent'}"
    finally:
        ground.stop()


def exit_status(found: Sequence[VehicleInfo]) -> int:
    """0 all answered; 10 nobody; 50 some."""
    if all(one.trouble for one in found):
        return EXIT_NO_ANSWER
    return status_of([not one.trouble for one in found])


def as_text(found: Sequence[VehicleInfo]) -> str:
    """The list for people."""
    lines: list[str] = []
    for one in found:
        if one.trouble:
            lines += textwrap.wrap(
                f"{one.name}: no answer. {one.trouble}", _WIDTH, subsequent_indent="  "
            )
            continue
        lines.append(f"{one.name}:")
        for subject, text in one.facts.items():
            first = f"  {subject:<11}"
            lines += textwrap.wrap(
                text, _WIDTH, initial_indent=first, subsequent_indent=" " * len(first)
            )
    return "\n".join(lines)


def as_mapping(found: Sequence[VehicleInfo]) -> dict[str, Any]:
    """The same for programs."""
    return {
        one.name: {"answers": not one.trouble, "trouble": one.trouble, **one.facts} for one in found
    }
