"""Certificates as they stand in files: read, and checked against each other and against the clock."""

from __future__ import annotations

import datetime

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import NameOID

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
