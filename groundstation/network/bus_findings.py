"""Findings of ``covey check`` about the bus of a fleet file.

They tell whether the radio can carry the messages, whether a dying router interrupts the poses, and
whether strangers can reach a bus without keys.
"""

from __future__ import annotations

from onboard.config.endpoints import is_loopback
from onboard.config.fleet import FleetConfig, RadioConfig
from onboard.feasibility.airtime import airtime_finding
from onboard.feasibility.finding import Finding
from onboard.neighbours.subscription import most_near
from onboard.plain_text import numbered
from onboard.safety.limits import POSITION_LOST_S

_ROUTER_GAP_S = 1.0  # time without poses when a router dies, measured with QUIC: docs/network.md


def bus_findings(fleet: FleetConfig) -> list[Finding]:
    """Return the load of the radio, and warnings about routers and missing keys."""
    findings = []

    # vehicles whose agents other computers can reach
    reachable = [name for name in fleet.enabled_names if not is_loopback(fleet.vehicles[name].host)]
    if len(fleet.enabled_names) > 1 and (fleet.radio is not None or reachable):
        radio = RadioConfig() if fleet.radio is None else fleet.radio
        findings.append(airtime_finding(fleet, radio, _most_near(fleet)))

    # vehicles whose poses come over the bus only
    dependent = [
        name
        for name in fleet.enabled_names
        if fleet.vehicles[name].mocap_required and not fleet.mocap.direct
    ]
    if fleet.fleet.routers and dependent:
        findings.append(_router_finding(len(dependent)))

    if reachable and not fleet.has_keys:
        findings.append(_keys_finding(fleet, len(reachable)))
    return findings


def _most_near(fleet: FleetConfig) -> int:
    """Return the largest number of near neighbours of a vehicle, at the starts or in formation."""
    starts = {name: fleet.vehicles[name].start_enu_m for name in fleet.enabled_names}
    most = 0
    for positions_enu_m in (starts, *fleet.formations.values()):
        if len(positions_enu_m) > 1:
            most = max(most, most_near(fleet, positions_enu_m))
    return most


def _router_finding(count: int) -> Finding:
    remedy = (
        "Let each vehicle read the motion capture itself ([mocap] direct = true), or fly without"
        " routers."
    )
    sentence = (
        f"The poses of {numbered(count, 'vehicle')} come over routers. When one dies, nothing comes"
        f" for up to {_ROUTER_GAP_S:g} s, and who has no poses for {POSITION_LOST_S:g} s lands."
        f" {remedy}"
    )
    return Finding(
        name="poses over routers",
        status="warning",
        value=_ROUTER_GAP_S,
        bound=POSITION_LOST_S,
        unit="s",
        relation="at most",
        sentence=sentence,
        remedy=remedy,
    )


def _keys_finding(fleet: FleetConfig, reachable_count: int) -> Finding:
    remedy = f"Lock the bus: covey keys secure {fleet.path} (docs/keys.md)."
    sentence = (
        f"The bus has no keys, and {numbered(reachable_count, 'vehicle')} can be reached from other"
        " computers: whoever reaches one of them orders, kills, and reads everything."
        f" {remedy}"
    )
    return Finding(
        name="keys of the bus",
        status="warning",
        value=reachable_count,
        bound=0.0,
        unit="vehicles",
        relation="at most",
        sentence=sentence,
        remedy=remedy,
    )
