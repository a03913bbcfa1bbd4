"""Makes keys and certificates: a fleet's certificate authority, and a certificate for each node.

The authority has an ECDSA key on the curve P-256. The nodes have Ed25519 keys, with which they also
sign orders. Certificates are X.509. The authority's key, ``ca.key``, is needed to make new nodes;
it stays on the computer where the fleet is prepared.
"""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from groundstation.keys.key_folder import make_key_folder, write_files
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.security.certificates import read_certificate, read_key
from onboard.security.node_roles import NODES, ROUTER
from onboard.security.private_files import refuse_open_to_others

# validity of certificates
AUTHORITY_DAYS = 3650
NODE_DAYS = 825

AUTHORITY_KEY = "ca.key"  # name of the file in the folder of the keys

_Key = ec.EllipticCurvePrivateKey | ed25519.Ed25519PrivateKey
# A certificate is valid from this long before its issue, because the clock of a companion computer
# without a network is behind.
_EARLIER = datetime.timedelta(days=1)


@dataclass(frozen=True, slots=True)
class CertificateAuthority:
    """A fleet's authority; the holder of its key can make nodes."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


def folder_of(fleet: FleetConfig) -> Path:
    """Return the folder of a fleet's keys."""
    return Path(fleet.keys_folder)


def nodes_of(fleet: FleetConfig) -> list[str]:
    """Return the names of all nodes that need a certificate."""
    nodes = [*fleet.vehicles, *(role.value for role in NODES)]
    if fleet.fleet.routers:
        nodes.append(ROUTER)
    return nodes


def make_authority(folder: Path, fleet_name: str, now: datetime.datetime) -> CertificateAuthority:
    """Make a new authority, and write its certificate and its key.

    Args:
        folder: folder of the keys.
        fleet_name: name of the fleet, for the authority's common name.
        now: present time. The certificate is valid from a day before.

    Raises:
        ConfigError: the files cannot be written.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"{fleet_name} authority")
    builder = _builder(name, name, key, now, AUTHORITY_DAYS)
    # path_length 0: it signs nodes, but no other authority
    constraints = x509.BasicConstraints(ca=True, path_length=0)
    certificate = builder.add_extension(constraints, critical=True).sign(key, hashes.SHA256())

    make_key_folder(folder)
    write_files({folder / AUTHORITY_KEY: _key_pem(key), folder / "ca.pem": _pem(certificate)})
    return CertificateAuthority(certificate, key)


def load_authority(fleet: FleetConfig) -> CertificateAuthority:
    """Read the authority.

    Args:
        fleet: the fleet, with the folder of the keys.

    Raises:
        ConfigError: the authority's key is not on this computer, is damaged, belongs to another
            certificate, or can be read by other users.
    """
    folder = folder_of(fleet)
    path = folder / AUTHORITY_KEY
    command = f"covey keys init {fleet.path} --force"  # makes a new authority
    if not path.exists():
        raise ConfigError(
            f"{path} is not on this computer. Certificates are issued where the fleet was"
            f" prepared; or begin anew: {command}"
        )

    refuse_open_to_others(path)
    key = read_key(str(path), f"Begin anew: {command}")
    certificate = read_certificate(
        str(folder / "ca.pem"),
        f"Copy it from another computer of the fleet, or begin anew: {command}",
    )
    is_of_certificate = key.public_key() == certificate.public_key()
    if isinstance(key, ec.EllipticCurvePrivateKey) and is_of_certificate:
        return CertificateAuthority(certificate, key)
    raise ConfigError(
        f"{path} does not belong to {folder / 'ca.pem'}. Copy both together, "
        f"or begin anew: {command}"
    )


def has_authority_key(fleet: FleetConfig) -> bool:
    """Return whether the authority's key is on this computer.

    Args:
        fleet: the fleet, with the folder of the keys.

    Raises:
        ConfigError: the key is damaged, belongs to another certificate, or other users can read it.
    """
    if not (folder_of(fleet) / AUTHORITY_KEY).exists():
        return False
    load_authority(fleet)
    return True


def issue(
    folder: Path,
    authority: CertificateAuthority,
    node: str,
    hosts: Iterable[str],
    now: datetime.datetime,
) -> None:
    """Make a node's key and certificate, and write them.

    Args:
        folder: folder of the keys.
        authority: the authority that signs the certificate.
        node: name of a vehicle or a role, which becomes the common name.
        hosts: addresses and names at which other nodes reach this node.
        now: present time. The certificate is valid from a day before.

    Raises:
        ConfigError: the files cannot be written.
    """
    key = ed25519.Ed25519PrivateKey.generate()
    constraints = x509.BasicConstraints(ca=False, path_length=None)
    usages = x509.ExtendedKeyUsage(
        [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    )
    addresses = [_address(host) for host in hosts]
    names = x509.SubjectAlternativeName([*addresses, x509.DNSName(node)])

    builder = _builder(_name(node), authority.certificate.subject, key, now, NODE_DAYS)
    certificate = (
        builder.add_extension(constraints, critical=True)
        .add_extension(usages, critical=False)
        .add_extension(names, critical=False)
        .sign(authority.key, hashes.SHA256())
    )
    write_files({folder / f"{node}.key": _key_pem(key), folder / f"{node}.pem": _pem(certificate)})


def _builder(
    subject: x509.Name, issuer: x509.Name, key: _Key, now: datetime.datetime, days: int
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLIER)
        .not_valid_after(now + datetime.timedelta(days=days))
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _address(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host.strip("[]")))
    except ValueError:
        return x509.DNSName(host)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _key_pem(key: _Key) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
