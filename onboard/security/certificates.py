"""Reads certificates and private keys from files, and checks that they match.

A certificate contains its holder's name, and the addresses where other nodes connect to the holder.
The fleet's certificate authority signs it.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.types import PrivateKeyTypes
from cryptography.hazmat.primitives.serialization import load_pem_private_key
from cryptography.x509.oid import NameOID

from onboard.config.file_reading import KEY_FILE, read_bytes
from onboard.config.fleet import ConfigError
from onboard.security.certificate_times import NotYetValidError
from onboard.security.node_roles import NodeRole

# raised for data that is no certificate, or one of an unknown version or kind
NO_CERTIFICATE = (ValueError, TypeError, x509.InvalidVersion, UnsupportedAlgorithm)


def check(authority: str, certificate: str, key: str, node: str, now: datetime.datetime) -> None:
    """Check that the three files of a node match.

    Args:
        authority: path of the certificate of the fleet's certificate authority.
        certificate: path of the node's own certificate.
        key: path of the node's private key.
        node: name that the certificate's holder must have.
        now: time at which both certificates must be valid.
    Raises:
        NotYetValidError: a certificate is not valid yet.
        ConfigError: they do not match, or are not valid any more.
    """
    issuer = read_certificate(
        authority,
        "Copy it from another computer of the fleet, or begin anew: covey keys init FLEET --force",
    )
    own = read_certificate(certificate)

    if common_name(own) != node:
        holder = common_name(own) or "nobody"
        raise ConfigError(f"{certificate} is the certificate of {holder}, not of {node}.")
    if not issued_by(own, issuer):
        raise ConfigError(
            f"{certificate} was not issued by {authority}: it is of another fleet, or of an "
            "authority that was replaced. Copy the node's new files, or issue them: "
            "covey keys renew FLEET"
        )

    _check_time(authority, issuer, now)
    _check_time(certificate, own, now)

    private_key = read_key(key)
    if private_key.public_key() != own.public_key():
        raise ConfigError(
            f"{key} does not belong to {certificate}. Copy both files of the node together."
        )
    if node == NodeRole.GROUND and not isinstance(private_key, Ed25519PrivateKey):
        raise ConfigError(
            f"{key} is of a former kind that signs no orders. Issue it anew: "
            f"covey keys issue FLEET {node}"
        )


def _check_time(path: str, certificate: x509.Certificate, now: datetime.datetime) -> None:
    """Check that a certificate is valid at a time; otherwise raise ConfigError."""
    first = certificate.not_valid_before_utc
    last = certificate.not_valid_after_utc
    remedy = (
        f"this computer's clock says {now:%Y-%m-%d}. Set the clock, or issue new certificates: "
        "covey keys renew FLEET"
    )
    if now < first:
        raise NotYetValidError(f"{path} is not valid before {first:%Y-%m-%d}; {remedy}")
    if now > last:
        raise ConfigError(f"{path} has expired on {last:%Y-%m-%d}; {remedy}")


def check_hosts(certificate: str, node: str, hosts: Iterable[str]) -> None:
    """Check that a certificate contains the addresses at which other nodes connect to its node.

    A node connects only to an address that is in the other node's certificate.

    Args:
        certificate: path of the certificate.
        node: its holder.
        hosts: names and addresses of that node in the fleet file.
    Raises:
        ConfigError: one of the hosts is not in the certificate.
    """
    issued = _names_in(read_certificate(certificate))
    for host in hosts:
        if host.strip("[]") in issued:
            continue

        # the certificate lists the holder's own name beside the addresses
        addresses = ", ".join(name for name in issued if name != node)
        if not addresses:
            addresses = "no address"
        raise ConfigError(
            f"{certificate} is for {addresses}, but the fleet file has {node} at {host}: nobody "
            f"would connect to it. Issue it anew: covey keys issue FLEET {node}"
        )


def _names_in(certificate: x509.Certificate) -> list[str]:
    """Return the addresses and names to which others may connect; none if it lists none."""
    try:
        extensions = certificate.extensions
        names = extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (
        ValueError,
        x509.DuplicateExtension,
        x509.ExtensionNotFound,
        x509.UnsupportedGeneralNameType,
    ):
        return []

    addresses = [str(address) for address in names.get_values_for_type(x509.IPAddress)]
    return addresses + names.get_values_for_type(x509.DNSName)


def read_certificate(
    path: str, remedy: str = "Copy it again, or issue it anew."
) -> x509.Certificate:
    """Read one certificate.

    Args:
        path: path of a PEM file.
        remedy: sentence of the error that says what to do.
    Raises:
        ConfigError: it cannot be read.
    """
    data = read_bytes(path, KEY_FILE._replace(words="certificate"))
    try:
        return x509.load_pem_x509_certificate(data)
    except NO_CERTIFICATE:
        raise ConfigError(f"{path} is no certificate, or was cut off. {remedy}") from None


def read_key(path: str, remedy: str = "Issue it anew: covey keys renew FLEET") -> PrivateKeyTypes:
    """Read a private key.

    Args:
        path: path of a PEM file.
        remedy: sentence of the error that says what to do.
    Raises:
        ConfigError: it cannot be read.
    """
    data = read_bytes(path, KEY_FILE._replace(words="private key"))
    try:
        return load_pem_private_key(data, None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise ConfigError(f"{path} is no private key, or was cut off. {remedy}") from None


def common_name(certificate: x509.Certificate) -> str:
    """Return the name of a certificate's holder; empty if the certificate does not have exactly
    one.
    """
    names = [name.value for name in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)]
    if len(names) == 1 and isinstance(names[0], str):
        return names[0]
    return ""


def issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    """Whether a certificate authority has directly signed a certificate."""
    try:
        certificate.verify_directly_issued_by(authority)
    except (*NO_CERTIFICATE, InvalidSignature):
        return False
    return True
