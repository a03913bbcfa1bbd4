"""Certificates of other programs, and files that are no certificates."""

from __future__ import annotations

import base64
import datetime
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from onboard.config.fleet import ConfigError
from onboard.security.certificate_ends import end_of
from onboard.security.certificates import check_hosts, read_certificate

NOW = datetime.datetime(2026, 6, 1, tzinfo=datetime.UTC)


def _certificate() -> x509.Certificate:
    """Return a certificate as other programs make them: without addresses."""
    key = Ed25519PrivateKey.generate()
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "mav1")])
    builder = x509.CertificateBuilder(
        subject_name=name,
        issuer_name=name,
        public_key=key.public_key(),
        serial_number=5,
        not_valid_before=NOW,
        not_valid_after=NOW + datetime.timedelta(days=9),
    )
    return builder.sign(key, None)


def test_a_certificate_without_addresses_is_for_no_address(tmp_path: Path) -> None:
    file = tmp_path / "mav1.pem"
    file.write_bytes(_certificate().public_bytes(Encoding.PEM))
    with pytest.raises(ConfigError, match=r"is for no address, .* covey keys issue FLEET mav1"):
        check_hosts(str(file), "mav1", ["10.0.0.1"])
    check_hosts(str(file), "ground", [])  # nobody connects to a ground


def test_a_certificate_of_another_version_is_no_certificate(tmp_path: Path) -> None:
    der = _certificate().public_bytes(Encoding.DER)
    changed = der.replace(b"\x02\x01\x02", b"\x02\x01\x03", 1)
    assert changed != der
    lines = base64.encodebytes(changed).decode("ascii")
    file = tmp_path / "mav1.pem"
    file.write_text(f"-----BEGIN CERTIFICATE-----\n{lines}-----END CERTIFICATE-----\n")

    with pytest.raises(ConfigError, match="is no certificate"):
        read_certificate(str(file))
    assert end_of(str(file)) is None
