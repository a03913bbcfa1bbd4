"""Facts that each PX4 reports about itself: version, board, uptime, state, sensors and links."""

from __future__ import annotations

import math
import textwrap
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from msgspec.structs import replace

from groundstation.client.autopilot_link import AutopilotLink
from groundstation.client.mavlink_port import AUTOPILOT
from groundstation.px4.vehicle_links import VehicleLink
from groundstation.px4.vehicle_parameters import status_of
from onboard.autopilot import MEASURED_VERSIONS, Landed, Snapshot, plausible_version
from onboard.config.fleet import Vehicle
from onboard.exit_status import EXIT_NO_ANSWER
from onboard.px4 import modes
from onboard.px4.battery_reports import BatteryReports
from onboard.px4.message_parsers import PARSERS
from onboard.px4.sensor_status import sensors

_LISTEN_S = 2.5
_ATTEMPTS = 3  # requests for the version, in total
_AGAIN_S = 1.0  # wait for the answer to a repeated request: twice the round trip of a slow radio
_AUTOPILOT_VERSION = 148  # id of a message that PX4 sends on request
_WIDTH = 118

# FIRMWARE_VERSION_TYPE of MAVLink.
_KINDS = {0: "development", 64: "alpha", 128: "beta", 192: "release candidate", 255: "release"}

# GPS_FIX_TYPE of MAVLink.
_FIXES = {
    0: "no receiver",
    1: "no fix",
    2: "2D fix",
    3: "3D fix",
    4: "3D fix, differential",
    5: "RTK float",
    6: "RTK",
}

# name of a message -> the newest one that was received
_Messages = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class VehicleInfo:
    """Facts about one vehicle."""

    name: str
    facts: dict[str, str] = field(default_factory=dict)  # subject -> fact in words
    trouble: str = ""  # why nothing was received; empty if something was


@dataclass(slots=True)
class _Traffic:
    """Counts the messages on one link."""

    count: int = 0
    is_signed: bool = False

    def take(self, message: Any) -> None:
        self.count += 1
        if message.get_signed():
            self.is_signed = True


class _Battery:
    """The battery, combined from the reports of all monitors as an agent combines them."""

    def __init__(self) -> None:
        # fields of a snapshot that describe the battery; empty before the first report
        self.fields: dict[str, Any] = {}
        self._reports = BatteryReports()

    def take(self, message: Any) -> None:
        is_report = message.get_type() == "BATTERY_STATUS"
        if is_report and message.get_srcComponent() == AUTOPILOT:
            report = PARSERS["BATTERY_STATUS"](message.to_dict(), time.monotonic_ns())
            self.fields |= self._reports.changes(message.id, report, is_armed=False)


def ask(link: VehicleLink, key: bytes | None = None) -> VehicleInfo:
    """Listen to one vehicle for some seconds; return the facts about it.

    Args:
        link: link to its PX4.
        key: key of its MAVLink signing; None if its messages are not signed.
    """
    if link.link is None:
        return VehicleInfo(link.vehicle.name, trouble=link.trouble)

    traffic = _Traffic()
    battery = _Battery()

    def take(message: Any) -> None:
        traffic.take(message)
        battery.take(message)

    heard = link.link.listen(_LISTEN_S, [_AUTOPILOT_VERSION], take=take)
    heard |= _version_again(link.link, heard)
    facts = {
        "version": _version(link, heard),
        "board": _board(heard),
        "uptime": _uptime(heard),
        "state": _state(heard, battery.fields),
        "sensors": _sensors(heard),
        "satellites": _satellites(heard),
        "links": _links(link, traffic, key),
    }
    if key is not None:
        facts["signing"] = "it signs with the key of this vehicle, and so does Covey."
    elif traffic.is_signed:
        facts["signing"] = (
            "it has a key of MAVLink signing and ignores what is not signed, and mavlink_signing"
            " is not true in the fleet file: Covey cannot fly it."
        )
    return VehicleInfo(link.vehicle.name, facts)


def _version_again(link: AutopilotLink, heard: _Messages) -> dict[str, Any]:
    """Request the version again if it has not come, because a message may be lost.

    Returns:
        The messages that PX4 sent meanwhile.
    """
    more: dict[str, Any] = {}
    for _ in range(_ATTEMPTS - 1):
        if "AUTOPILOT_VERSION" in (heard.keys() | more.keys()):
            break
        more |= link.listen(_AGAIN_S, [_AUTOPILOT_VERSION], until="AUTOPILOT_VERSION")
    return more


def _version(link: VehicleLink, heard: _Messages) -> str:
    """Return PX4's version with patch, kind and commit, and whether Covey was measured with it."""
    message = heard.get("AUTOPILOT_VERSION")
    version = link.version
    if message is None or version is None:
        return "PX4 does not say its version"
    if plausible_version(version) is None:
        return link.version_text

    # its four bytes are major, minor, patch, and the kind of firmware
    _, _, patch, kind_number = message.flight_sw_version.to_bytes(4, "big")
    kind = _KINDS.get(kind_number, f"type {kind_number}")
    commit = bytes(message.flight_custom_version)[::-1].hex()

    oldest, newest = MEASURED_VERSIONS
    remark = ""
    if not oldest <= version <= newest:
        remark = ", never measured with Covey"
    return f"{link.version_text}.{patch}, {kind}, commit {commit}{remark}"


def _board(heard: _Messages) -> str:
    message = heard.get("AUTOPILOT_VERSION")
    if message is None:
        return "not said"
    return (
        f"type {message.board_version >> 16}, vendor {message.vendor_id:04x},"
        f" product {message.product_id:04x}, serial {message.uid:016x}"
    )


def _uptime(heard: _Messages) -> str:
    times_ms = [
        message.time_boot_ms for message in heard.values() if hasattr(message, "time_boot_ms")
    ]
    if not times_ms:
        return "not said"
    up_s = max(times_ms) // 1000
    return f"{up_s // 3600} h {up_s // 60 % 60} min {up_s % 60} s"


def _snapshot(heard: _Messages, *names: str) -> Snapshot:
    """Return the values of some messages, parsed as an agent parses them."""
    changes: dict[str, Any] = {}
    for name in names:
        if name in heard:
            received_ns = 1  # any time but 0, which would mean "never"
            changes |= PARSERS[name](heard[name].to_dict(), received_ns)
    return Snapshot(**changes)


def _state(heard: _Messages, battery: Mapping[str, Any]) -> str:
    snapshot = replace(_snapshot(heard, "HEARTBEAT", "EXTENDED_SYS_STATE"), **battery)
    words = ["armed" if snapshot.is_armed else "disarmed", snapshot.mode or "mode not said"]
    if snapshot.landed is not Landed.UNKNOWN:
        words.append(snapshot.landed.name.lower().replace("_", " "))
    if snapshot.battery_ns:
        charge = "charge not said"
        if not math.isnan(snapshot.battery_frac):
            charge = f"{snapshot.battery_frac:.0%}"
        words.append(f"battery {charge}, {snapshot.battery_voltage_v:.1f} V")
    if "HEARTBEAT" in heard and heard["HEARTBEAT"].system_status in modes.FAILSAFE_STATUSES:
        words.append("in a failsafe")
    return ", ".join(words)


def _sensors(heard: _Messages) -> str:
    if "SYS_STATUS" not in heard:
        return "not said"
    reported = sensors(_snapshot(heard, "SYS_STATUS"))
    healthy = [name for name, is_healthy in reported if is_healthy]
    unhealthy = [name for name, is_healthy in reported if not is_healthy]
    return f"healthy: {_listed(healthy)}; unhealthy: {_listed(unhealthy)}"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) if names else "none"


def _satellites(heard: _Messages) -> str:
    message = heard.get("GPS_RAW_INT")
    if message is None:
        return "no receiver reports"
    fix = _FIXES.get(message.fix_type, f"fix {message.fix_type}")
    return f"{fix}, {message.satellites_visible} satellites"


def _links(link: VehicleLink, traffic: _Traffic, key: bytes | None) -> str:
    parts = [f"{link.endpoint}: {traffic.count / _LISTEN_S:.0f} messages/s"]
    if link.endpoint == link.vehicle.autopilot:
        parts.append(_direct_link(link.vehicle, key))
    else:
        parts += link.silent_links
    return "; ".join(part.rstrip(".") for part in parts)


def _direct_link(vehicle: Vehicle, key: bytes | None) -> str:
    """Return in words whether PX4 also answers on its direct link."""
    if vehicle.direct is None:
        return "no direct link in the fleet file"
    try:
        direct_link = AutopilotLink(vehicle.direct, vehicle.system_id, key=key)
    except (OSError, ValueError) as error:
        return f"{vehicle.direct}: {error}"

    try:
        is_heard = direct_link.is_armed() is not None
        return f"{vehicle.direct}: {'answers' if is_heard else 'silent'}"
    finally:
        direct_link.stop()


def exit_status(infos: Sequence[VehicleInfo]) -> int:
    """Return 0 if all vehicles answered, 10 if none did, 50 if some did."""
    if all(vehicle.trouble for vehicle in infos):
        return EXIT_NO_ANSWER
    return status_of([not vehicle.trouble for vehicle in infos])


def as_text(infos: Sequence[VehicleInfo]) -> str:
    """Return the list for people."""
    lines: list[str] = []
    for vehicle in infos:
        if vehicle.trouble:
            text = f"{vehicle.name}: no answer. {vehicle.trouble}"
            lines += textwrap.wrap(text, _WIDTH, subsequent_indent="  ")
            continue

        lines.append(f"{vehicle.name}:")
        for subject, text in vehicle.facts.items():
            head = f"  {subject:<11}"
            indent = " " * len(head)
            lines += textwrap.wrap(text, _WIDTH, initial_indent=head, subsequent_indent=indent)
    return "\n".join(lines)


def as_mapping(infos: Sequence[VehicleInfo]) -> dict[str, Any]:
    """Return the answers of vehicles as data for programs."""
    return {
        vehicle.name: {
            "answers": not vehicle.trouble,
            "trouble": vehicle.trouble,
            **vehicle.facts,
        }
        for vehicle in infos
    }
