"""A node's certificate and key: files in ``keys/`` beside the fleet file, checked before the bus is opened.

``ca.pem`` is the fleet's own authority, ``NODE.pem`` a node's certificate, ``NODE.key`` its private key, which never
leaves the computer of that node. ``covey secure`` makes them.
"""

from __future__ import annotations

import datetime
import os
import stat
from dataclasses import dataclass

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import NameOID

from onboard.bus.roles import Role, access_control
from onboard.config.fleet import ConfigError, FleetConfig

_REMEDY = "Make what is missing with: covey secure {fleet}"


@dataclass(frozen=True, slots=True)
class Credentials:
    """Files of one node, and what may come in from whom."""

    authority: str
    certificate: str
    key: str
    access: dict[str, object]


def files_of(node: str) -> tuple[str, str, str]:
    """Return the files of a node: authority, certificate, private key."""
    return "ca.pem", f"{node}.pem", f"{node}.key"


def credentials_of(fleet: FleetConfig, node: str, now: datetime.datetime | None = None) -> Credentials | None:
    """Return a node's credentials; None for a fleet whose bus has no keys.

    Args:
        fleet: the fleet file.
        node: a vehicle's name, or the value of a role.
        now: time at which the certificate must be valid; by default this computer's.
    Returns:
        paths of files that exist and fit together.
    Raises:
        ConfigError: a file is missing, damaged, of another authority, not valid now, or open to others.
    """
    if not fleet.has_keys:
        return None
    authority, certificate, key = (os.path.join(fleet.keys_folder, name) for name in files_of(node))
    remedy = _REMEDY.format(fleet=fleet.path)
    for path in (authority, certificate, key):
        if not os.path.isfile(path):
            raise ConfigError(f"{path} is missing: {_who(node)} cannot join this fleet's bus. {remedy}")
    mode = stat.S_IMODE(os.stat(key).st_mode)
    if mode & 0o077:
        raise ConfigError(f"{key} can be read by other users of this computer (mode {mode:o}). Run: chmod 600 {key}")
    check(authority, certificate, key, node, now or datetime.datetime.now(datetime.UTC))
    return Credentials(authority, certificate, key, access_control(fleet.namespace, fleet.vehicles))


def check(authority: str, certificate: str, key: str, node: str, now: datetime.datetime) -> None:
    """Check that three files fit together.

    Args:
        authority, certificate, key: paths.
        node: the name that the certificate must carry.
        now: time at which it must be valid.
    Raises:
        ConfigError: they do not.
    """
    issuer, own = read_certificate(authority), read_certificate(certificate)
    names = [name.value for name in own.subject.get_attributes_for_oid(NameOID.COMMON_NAME)]
    if names != [node]:
        raise ConfigError(
            f"{certificate} is the certificate of {' '.join(map(str, names)) or 'nobody'}, not of {node}."
        )
    try:
        own.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        raise ConfigError(
            f"{certificate} was not issued by {authority}: it is of another fleet, or of an authority that was "
            "replaced. Copy the node's new files, or issue them: covey keys renew FLEET"
        ) from None
    for path, each in ((authority, issuer), (certificate, own)):
        first, last = each.not_valid_before_utc, each.not_valid_after_utc
        if not first <= now <= last:
            what = "is not valid before" if now < first else "has expired on"
            when = first if now < first else last
            raise ConfigError(
                f"{path} {what} {when:%Y-%m-%d}; this computer's clock says {now:%Y-%m-%d}. Set the clock, or issue "
                "new certificates: covey keys renew FLEET"
            )
    try:
        with open(key, "rb") as file:
            private = load_pem_private_key(file.read(), None)
    except (OSError, ValueError, TypeError):
        raise ConfigError(f"{key} is no private key, or was cut off. Issue it anew: covey keys renew FLEET") from None
    if private.public_key() != own.public_key():
        raise ConfigError(f"{key} does not belong to {certificate}. Copy both files of the node together.")


def read_certificate(path: str) -> x509.Certificate:
    """Read one certificate.

    Args:
        path: of a PEM file.
    Raises:
        ConfigError: it cannot be read.
    """
    try:
        with open(path, "rb") as file:
            return x509.load_pem_x509_certificate(file.read())
    except (OSError, ValueError):
        raise ConfigError(f"{path} is no certificate, or was cut off. Copy it again, or issue it anew.") from None


def _who(node: str) -> str:
    roles = {
        Role.GROUND: "a ground that orders (one with keys/viewer.pem only may watch: --readonly)",
        Role.VIEWER: "a ground that only watches",
        Role.MOCAP: "the relay of the motion capture",
        Role.EMULATOR: "the emulator",
    }
    return next((words for role, words in roles.items() if role.value == node), f"the agent of {node}")
