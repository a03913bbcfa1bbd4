"""Keys of MAVLink signing: look at what each PX4 does, set its key, or remove it.

PX4 does not acknowledge a key. So its messages are checked afterwards: whether it signs them with
the key, and whether it still answers messages that are not signed.
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
_AUTOPILOT_VERSION = 148  # id of a message that PX4 sends on request
_ATTEMPTS = 3
_SINCE = ".".join(str(number) for number in SIGNING_SINCE)
KeyAction = Literal["look", "set", "remove"]


class Signs(Enum):
    """Whether and with which key a PX4 signs its messages, in words."""

    NOTHING = "does not sign its messages"
    OURS = "signs its messages with the key of this vehicle"
    OTHER = "signs its messages, with another key than this computer's"


def keys_of(
    fleet: FleetConfig, vehicles: Sequence[Vehicle], *, is_changed: bool
) -> dict[str, bytes]:
    """Read those keys of vehicles that this computer has.

    Args:
        fleet: the fleet file.
        vehicles: the vehicles.
        is_changed: whether keys are to be set or removed; then this computer must have the key of
            each vehicle.

    Returns:
        name of a vehicle -> key.

    Raises:
        ConfigError: a required key is missing, or its file holds no key.
    """
    keys = {}
    for vehicle in vehicles:
        path = os.path.join(fleet.keys_folder, key_file(vehicle.name))
        if is_changed or vehicle.mavlink_signing or os.path.exists(path):
            keys[vehicle.name] = read_key(path, fleet.path)
    return keys


def run(
    links: Sequence[VehicleLink],
    keys: Mapping[str, bytes],
    action: KeyAction,
    old_key: bytes | None,
) -> list[VehicleReport]:
    """Look at several PX4s, and set or remove their keys.

    Args:
        links: links to them, which receive messages with any signature.
        keys: name of a vehicle -> its key.
        action: whether to look only, to set the key, or to remove it.
        old_key: the key that PX4 has now, if it is not the one in ``keys``; else None.
    """

    def run_one(link: VehicleLink) -> VehicleReport:
        return _run_one(link, keys.get(link.vehicle.name), action, old_key)

    return for_each(run_one, links)


def _run_one(
    link: VehicleLink, key: bytes | None, action: KeyAction, old_key: bytes | None
) -> VehicleReport:
    name = link.vehicle.name
    if link.link is None:
        return VehicleReport(name, False, link.trouble, answers=False)

    signs = _state(link.link, key)
    if action == "look":
        return _looked_at(link, signs)

    required = Signs.OURS if action == "set" else Signs.NOTHING
    refusal = _refusal(link, signs, action, old_key)
    if refusal:
        is_fine = signs is required  # the refused change was not necessary
        return VehicleReport(name, is_fine, refusal)
    if signs is required:
        headline = f"nothing was changed: {_words(link, signs)} already."
        return VehicleReport(name, True, headline)

    present_key = None  # the key with which the message that changes it must be signed
    if signs is Signs.OTHER:
        present_key = old_key
    elif signs is Signs.OURS:
        present_key = key
    new_key = key if action == "set" else None

    # repeated, because the message may be lost and PX4 does not answer it
    for _ in range(_ATTEMPTS):
        link.link.sign(present_key)
        link.link.set_key(new_key)
        signs = _state(link.link, key)
        if signs is required:
            break

    if action == "remove":
        return _removed(link, signs)
    return _set(link, signs)


def _refusal(link: VehicleLink, signs: Signs, action: KeyAction, old_key: bytes | None) -> str:
    """Return why the key cannot be changed; empty if it can."""
    assert link.link is not None
    if not link.link.is_own:
        refusal = (
            "nothing was changed: a key is set over the vehicle's own link only. Stop its agent;"
            " on a companion computer run this command there."
        )
        return f"{refusal} {' '.join(link.silent_links)}".rstrip()

    if link.is_armed:
        return "nothing was changed: it is armed, and PX4 takes no key then. Land and disarm it."

    if action == "set" and _is_too_old(link):
        return f"nothing was changed: {link.version_text} knows no signing, v{_SINCE} and later do."

    if signs is Signs.OTHER and (action == "remove" or old_key is None):
        return (
            f"nothing was changed: PX4 {signs.value}. Give the key that it has with --set --old"
            " FILE; if nobody has it, docs/mavlink-signing.md says how to get rid of it."
        )
    return ""


def _is_too_old(link: VehicleLink) -> bool:
    """Return whether a PX4 is known to be too old for signing."""
    version = plausible_version(link.version)
    return version is not None and version < SIGNING_SINCE


def _removed(link: VehicleLink, signs: Signs) -> VehicleReport:
    """Return the report about a PX4 whose key was to be removed."""
    is_gone = signs is Signs.NOTHING
    result = " any more" if is_gone else ": it kept its key"
    hint = ""
    if link.vehicle.mavlink_signing:
        hint = " Write mavlink_signing = false for it in the fleet file."
    return VehicleReport(link.vehicle.name, is_gone, f"PX4 {signs.value}{result}.{hint}")


def _set(link: VehicleLink, signs: Signs) -> VehicleReport:
    """Return the report about a PX4 whose key was to be set."""
    name = link.vehicle.name
    if signs is not Signs.OURS:
        headline = f"PX4 took no key: it {signs.value}. Restart it, and try once more."
        return VehicleReport(name, False, headline)

    ignores_unsigned = not _answers_unsigned(link.link)
    result = "STILL ANSWERS what is not signed"
    if ignores_unsigned:
        result = "ignores what is not signed"
    hint = ""
    if not link.vehicle.mavlink_signing:
        hint = " Write mavlink_signing = true for it, or its agent is not heard."
    headline = f"the key is set: PX4 signs with it and {result}.{hint}"
    return VehicleReport(name, ignores_unsigned, headline)


def _looked_at(link: VehicleLink, signs: Signs) -> VehicleReport:
    """Return the report about whether a PX4 signs as the fleet file demands."""
    is_demanded = link.vehicle.mavlink_signing
    demanded = Signs.OURS if is_demanded else Signs.NOTHING
    is_fine = signs is demanded
    demand = ""
    if not is_fine:
        demand = f" The fleet file says mavlink_signing = {str(is_demanded).lower()}."
    return VehicleReport(link.vehicle.name, is_fine, f"{_words(link, signs)}.{demand}")


def _words(link: VehicleLink, signs: Signs) -> str:
    reason = ""
    if _is_too_old(link):
        reason = f" (before v{_SINCE} none can)"
    return f"{link.version_text} {signs.value}{reason}"


def _state(link: AutopilotLink, key: bytes | None) -> Signs:
    """Listen for a moment; return how PX4 signs its messages.

    Messages that are sent meanwhile are signed with the key, so that PX4's timestamps catch up.
    """
    signing = link.sign(key)

    # first skip messages that PX4 has sent before, since they may be signed in another way
    link.listen(_LISTEN_S, [_AUTOPILOT_VERSION])
    signed_before = signing.sig_count
    good_before = signing.goodsig_count

    link.listen(_LISTEN_S)
    if signing.goodsig_count > good_before:
        return Signs.OURS
    if signing.sig_count > signed_before:
        return Signs.OTHER
    return Signs.NOTHING


def _answers_unsigned(link: AutopilotLink | None) -> bool:
    """Return whether PX4 answers a request that is not signed."""
    assert link is not None
    link.sign(None)
    return link.version() is not None
