"""Keys of MAVLink signing: what each PX4 does with its messages, and giving it a key or taking it
away.

PX4 acknowledges no key. So what it does afterwards is looked at: whether it signs with the key, and
whether it still answers what is not signed.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Literal

from groundstation.client.autopilot_link import AutopilotLink
from groundstation.px4.parameter_sets import VehicleReport
from groundstation.px4.vehicle_links import VehicleLink, for_each
from onboard.autopilot import SIGNING_SINCE, plausible_version
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.security.mavlink_key import key_file, read_key

_LISTEN_S = 0.5
_AUTOPILOT_VERSION = 148
_ATTEMPTS = 3
_SINCE = ".".join(map(str, SIGNING_SINCE))
Action = Literal["look", "set", "remove"]


class Signs(Enum):
    """What a PX4 does with the messages that it sends, in words."""

    NOTHING = "does not sign its messages"
    OURS = "signs its messages with the key of this vehicle"
    OTHER = "signs its messages, with another key than this computer's"


def keys_of(
    fleet: FleetConfig, vehicles: Sequence[Vehicle], *, is_changed: bool
) -> dict[str, bytes]:
    """Read the keys of vehicles, as far as they are here.

    Args:
        fleet: the fleet file.
        vehicles: whose.
        is_changed: whether PX4 is to be given a key, or to lose it: then each vehicle must have one
            here.
    Returns:
        vehicle -> key.
    Raises:
        ConfigError: a key is missing that is needed, or is none.
    """
    keys = {}
    for vehicle in vehicles:
        path = os.path.join(fleet.keys_folder, key_file(vehicle.name))
        if is_changed or vehicle.mavlink_signing or os.path.exists(path):
            keys[vehicle.name] = read_key(path, fleet.path)
    return keys


def run(
    links: Sequence[VehicleLink], keys: Mapping[str, bytes], action: Action, old_key: bytes | None
) -> list[VehicleReport]:
    """Look at several PX4s, and set or remove their keys.

    Args:
        links: to them, hearing whatever they sign with.
        keys: vehicle -> key.
        action: what to do.
        old_key: that they have now, where it is another one.
    """
    return for_each(lambda link: _one(link, keys.get(link.vehicle.name), action, old_key), links)


def _one(
    link: VehicleLink, key: bytes | None, action: Action, old_key: bytes | None
) -> VehicleReport:
    if link.link is None:
        return VehicleReport(link.vehicle.name, False, link.trouble, answers=False)
    found = _state(link.link, key)
    if action == "look":
        return _looked(link, found, key)
    trouble = _refusal(link, found, action, old_key)
    is_there = found is (Signs.OURS if action == "set" else Signs.NOTHING)
    if trouble or is_there:
        words = trouble or f"nothing was changed: {_words(link, found)} already."
        return VehicleReport(link.vehicle.name, is_there, words)
    present = old_key if found is Signs.OTHER else key if found is Signs.OURS else None
    for _ in range(_ATTEMPTS):
        link.link.sign(present)
        link.link.set_key(key if action == "set" else None)
        found = _state(link.link, key)
        if found is (Signs.OURS if action == "set" else Signs.NOTHING):
            break
    return _changed(link, found, key, action)


def _refusal(link: VehicleLink, found: Signs, action: Action, old_key: bytes | None) -> str:
    """Why nothing can be changed; empty when it can."""
    assert link.link is not None
    if not link.link.is_own:
        return (
            "nothing was changed: a key is set over the vehicle's own link only. Stop its agent; on a companion "
            f"computer run this command there. {' '.join(link.silent_links)}".rstrip()
        )
    if link.is_armed:
        return "nothing was changed: it is armed, and PX4 takes no key then. Land and disarm it."
    version = plausible_version(link.version)
    if action == "set" and version is not None and version < SIGNING_SINCE:
        return f"nothing was changed: {link.version_text} knows no signing, v{_SINCE} and later do."
    if found is Signs.OTHER and (action == "remove" or old_key is None):
        return (
            f"nothing was changed: PX4 {found.value}. Give the key that it has with --set --old FILE; if nobody has "
            "it, docs/mavlink-signing.md says how to get rid of it."
        )
    return ""


def _changed(link: VehicleLink, found: Signs, key: bytes | None, action: Action) -> VehicleReport:
    name = link.vehicle.name
    if action == "remove":
        is_gone = found is Signs.NOTHING
        hint = (
            " Write mavlink_signing = false for it in the fleet file."
            if link.vehicle.mavlink_signing
            else ""
        )
        return VehicleReport(
            name,
            is_gone,
            f"PX4 {found.value}{' any more' if is_gone else ': it kept its key'}.{hint}",
        )
    if found is not Signs.OURS:
        return VehicleReport(
            name, False, f"PX4 took no key: it {found.value}. Restart it, and try once more."
        )
    is_deaf = not _answers_unsigned(link.link)
    hint = (
        ""
        if link.vehicle.mavlink_signing
        else " Write mavlink_signing = true for it, or its agent is not heard."
    )
    ignores = "ignores what is not signed" if is_deaf else "STILL ANSWERS what is not signed"
    return VehicleReport(name, is_deaf, f"the key is set: PX4 signs with it and {ignores}.{hint}")


def _looked(link: VehicleLink, found: Signs, key: bytes | None) -> VehicleReport:
    demanded = link.vehicle.mavlink_signing
    is_fine = found is (Signs.OURS if demanded else Signs.NOTHING)
    demand = "" if is_fine else f" The fleet file says mavlink_signing = {str(demanded).lower()}."
    return VehicleReport(link.vehicle.name, is_fine, f"{_words(link, found)}.{demand}")


def _words(link: VehicleLink, found: Signs) -> str:
    version = plausible_version(link.version)
    cannot = (
        f" (before v{_SINCE} none can)" if version is not None and version < SIGNING_SINCE else ""
    )
    return f"{link.version_text} {found.value}{cannot}"


def _state(link: AutopilotLink, key: bytes | None) -> Signs:
    """Listen for a moment; sent is what is signed with the key, so that PX4's timestamps catch up."""
    signing = link.sign(key)
    # what it had sent before is no sign of what it does now
    link.listen(_LISTEN_S, [_AUTOPILOT_VERSION])
    seen, good = signing.sig_count, signing.goodsig_count
    link.listen(_LISTEN_S)
    if signing.goodsig_count > good:
        return Signs.OURS
    return Signs.OTHER if signing.sig_count > seen else Signs.NOTHING


def _answers_unsigned(link: AutopilotLink | None) -> bool:
    assert link is not None
    link.sign(None)
    return link.version() is not None
