"""Orders signed end to end: what the vehicle believes, and each way an order can be false."""

from __future__ import annotations

import datetime
import shutil
from collections import Counter
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec.structs import replace

from groundstation.keys.secured_fleet import secure_fleet
from onboard.bus.codec import encode
from onboard.bus.schema import Order
from onboard.config.fleet import FleetConfig
from onboard.security.certificates import read_certificate
from onboard.security.order_signature import MAX_FALSE_PER_S, OrderSeal, OrderSigner, SealCheck

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"
NOW = datetime.datetime(2026, 6, 1, tzinfo=datetime.UTC)
KEY = "covey/paper/order/mav1"
LAND = Order(order_id="g-1", author="ann", kind="land", stamp_ns=1, deadline_ns=2, node="g")


def _made(folder: Path) -> FleetConfig:
    folder.mkdir()
    shutil.copy(PAPER, folder / "fleet.toml")
    return secure_fleet(str(folder / "fleet.toml"), NOW)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> FleetConfig:
    """The paper's fleet with keys."""
    return _made(tmp_path_factory.mktemp("fleet") / "own")


def _signer(fleet: FleetConfig, node: str) -> OrderSigner:
    return OrderSigner(f"{fleet.keys_folder}/{node}.pem", f"{fleet.keys_folder}/{node}.key")


def _of_version_4(fleet: FleetConfig) -> bytes:
    """Return the ground's certificate (DER), changed to a version that X.509 does not have."""
    certificate = read_certificate(f"{fleet.keys_folder}/ground.pem")
    return certificate.public_bytes(Encoding.DER).replace(b"\x02\x01\x02", b"\x02\x01\x03", 1)


def test_an_order_signed_by_the_ground_is_believed_by_its_vehicle_only(fleet: FleetConfig) -> None:
    check = SealCheck(f"{fleet.keys_folder}/ca.pem")
    seal = _signer(fleet, "ground").seal(KEY, encode(LAND))
    assert check.refusal(KEY, encode(LAND), seal, NOW) is None
    assert check.refusal(KEY, encode(LAND), seal, NOW) is None  # the certificate is known by now
    for other_key in ("covey/paper/order/mav2", "covey/other/order/mav1"):
        redirected = check.refusal(other_key, encode(LAND), seal, NOW)
        assert redirected is not None
        assert redirected.code == "forged"
        assert redirected.order_id == "g-1"  # so that its sender can be answered


def test_each_false_order_is_refused_in_a_sentence_of_its_own(
    fleet: FleetConfig, tmp_path: Path
) -> None:
    check = SealCheck(f"{fleet.keys_folder}/ca.pem")
    order = encode(LAND)
    foreign = _made(tmp_path / "foreign")
    seal = _signer(fleet, "ground").seal(KEY, order)
    later = NOW + datetime.timedelta(days=2000)
    tries = {
        "unsigned": check.refusal(KEY, order, b"", NOW),
        "changed": check.refusal(KEY, encode(replace(LAND, kind="kill")), seal, NOW),
        "cut off": check.refusal(KEY, order, seal[:-9], NOW),
        "a vehicle's": check.refusal(KEY, order, _signer(fleet, "mav1").seal(KEY, order), NOW),
        "a viewer's": check.refusal(KEY, order, _signer(fleet, "viewer").seal(KEY, order), NOW),
        "another fleet's": check.refusal(
            KEY, order, _signer(foreign, "ground").seal(KEY, order), NOW
        ),
        "no certificate": check.refusal(
            KEY, order, encode(OrderSeal(certificate=b"x", signature=b"y")), NOW
        ),
        "another version": check.refusal(
            KEY,
            order,
            encode(OrderSeal(certificate=_of_version_4(fleet), signature=b"y")),
            NOW,
        ),
        "years later": check.refusal(KEY, order, seal, later),
        "years earlier": check.refusal(KEY, order, seal, NOW - datetime.timedelta(days=2000)),
    }
    codes = {name: found and found.code for name, found in tries.items()}
    assert codes == {
        "unsigned": "unsigned",
        "changed": "forged",
        "cut off": "forged",
        "a vehicle's": "role",
        "a viewer's": "role",
        "another fleet's": "foreign",
        "no certificate": "foreign",
        "another version": "foreign",
        "years later": "foreign",
        "years earlier": "foreign",
    }
    assert all(
        found is not None and "of ann (from g)" in found.sentence for found in tries.values()
    )
    assert "clock says 2031-11-22" in tries["years later"].sentence  # type: ignore[union-attr]


def test_an_order_that_cannot_be_read_has_no_author(fleet: FleetConfig) -> None:
    found = SealCheck(f"{fleet.keys_folder}/ca.pem").refusal(KEY, b"\xff" * 40, b"", NOW)
    assert found is not None
    assert found.sentence.startswith("An order that cannot be read is not signed")


def test_false_orders_in_a_flood_are_not_looked_at_and_keep_no_true_ground_from_ordering(
    fleet: FleetConfig,
) -> None:
    check = SealCheck(f"{fleet.keys_folder}/ca.pem")
    signer = _signer(fleet, "ground")
    order = encode(LAND)
    seal = signer.seal(KEY, order)
    assert check.refusal(KEY, order, seal, NOW) is None
    codes = Counter[str]()
    for number in range(1000):
        false = check.refusal(
            KEY, encode(replace(LAND, node=f"g-{number}", kind="kill")), seal, NOW
        )
        assert false is not None
        codes[false.code] += 1
    assert codes == {"forged": MAX_FALSE_PER_S, "flood": 1000 - MAX_FALSE_PER_S}
    assert check.refusal(KEY, order, seal, NOW) is None  # this ground has signed before
    new = encode(replace(LAND, node="new"))
    refused = check.refusal(KEY, new, signer.seal(KEY, new), NOW)
    assert refused is not None
    assert "not looked at" in refused.sentence
    assert (
        check.refusal(KEY, new, signer.seal(KEY, new), NOW + datetime.timedelta(seconds=1)) is None
    )
