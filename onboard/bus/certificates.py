"""Certificates as they stand in files: read, and checked against each other and against the clock."""

from __future__ import annotations

import datetime
from collections.abc import Iterable

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import NameOID

from onboard.bus.roles import Role
from onboard.config.fleet import ConfigError


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
    if common_name(own) != node:
        raise ConfigError(
            f"{certificate} is the certificate of {common_name(own) or 'nobody'}, not of {node}."
        )
    if not issued_by(own, issuer):
        raise ConfigError(
            f"{certificate} was not issued by {authority}: it is of another fleet, or of an authority that was "
            "replaced. Copy the node's new files, or issue them: covey keys renew FLEET"
        )
    for path, each in ((authority, issuer), (certificate, own)):
        first, last = each.not_valid_before_utc, each.not_valid_after_utc
        if not first <= now <= last:
            what = "is not valid before" if now < first else "has expired on"
            when = first if now < first else last
            raise ConfigError(
                f"{path} {what} {when:%Y-%m-%d}; this computer's clock says {now:%Y-%m-%d}. Set the clock, or issue "
                "new certificates: covey keys renew FLEET"
            )
    private = read_key(key)
    if private.public_key() != own.public_key():
        raise ConfigError(
            f"{key} does not belong to {certificate}. Copy both files of the node together."
        )
    if node == Role.GROUND and not isinstance(private, Ed25519PrivateKey):
        raise ConfigError(
            f"{key} is of a former kind that signs no orders. Issue it anew: covey keys issue FLEET {node}"
        )


def check_hosts(certificate: str, node: str, hosts: Iterable[str]) -> None:
    """Check that a certificate is for the addresses at which others connect to its node: they look.

    Args:
        certificate: path.
        node: its holder.
        hosts: names and addresses of the fleet file.
    Raises:
        ConfigError: it is for others.
    """
    extension = (
        read_certificate(certificate)
        .extensions.get_extension_for_class(x509.SubjectAlternativeName)
        .value
    )
    issued = [
        *map(str, extension.get_values_for_type(x509.IPAddress)),
        *extension.get_values_for_type(x509.DNSName),
    ]
    for host in hosts:
        if host.strip("[]") not in issued:
            addresses = ", ".join(one for one in issued if one != node) or "no address"
            raise ConfigError(
                f"{certificate} is for {addresses}, but the fleet file has {node} at {host}: nobody would connect to "
                f"it. Issue it anew: covey keys issue FLEET {node}"
            )


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
        raise ConfigError(
            f"{path} is no certificate, or was cut off. Copy it again, or issue it anew."
        ) from None


def read_key(path: str) -> PrivateKeyTypes:
    """Read a private key.

    Args:
        path: of a PEM file.
    Raises:
        ConfigError: it cannot be read.
    """
    try:
        with open(path, "rb") as file:
            return load_pem_private_key(file.read(), None)
    except (OSError, ValueError, TypeError):
        raise ConfigError(
            f"{path} is no private key, or was cut off. Issue it anew: covey keys renew FLEET"
        ) from None


def common_name(certificate: x509.Certificate) -> str:
    """Return the name of a certificate's holder; empty where it names none, or several."""
    names = [name.value for name in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)]
    return names[0] if len(names) == 1 and isinstance(names[0], str) else ""


def issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    """Whether an authority has signed a certificate itself."""
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True
