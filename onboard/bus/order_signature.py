"""Orders signed end to end: whatever carries an order, its vehicle knows whose key has given it.

Behind a router a vehicle sees the router's certificate, not the ground's. So the ground signs each
order with the key of its certificate (Ed25519), and the certificate travels beside it. The
signature covers the key on the bus, hence the fleet and the vehicle: an order for one vehicle is
none for another.
"""

from __future__ import annotations

import datetime
from collections import Counter

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding

from onboard.bus.certificates import common_name, issued_by, read_certificate, read_key
from onboard.bus.codec import Malformed, decode, encode
from onboard.bus.protocol import RefusalCode, UntrustedOrder
from onboard.bus.roles import Role
from onboard.bus.schema import Message, Order

_CONTEXT = b"covey order 1\0"  # no signature for another purpose is one of an order
# certificates that have been checked, and grounds that have signed; each ground has one
_MAX_KNOWN = 16
# of each ground that has signed before, and of all others together; then none is looked at
MOST_FALSE_PER_S = 200


class OrderSeal(Message, frozen=True, array_like=True, kw_only=True):
    """Travels beside an order."""

    certificate: bytes  # of the signer, DER
    signature: bytes  # over the key on the bus and the order's bytes


class OrderSigner:
    """Signs orders with a node's key.

    Args:
        certificate, key: paths of its files, checked before.
    """

    def __init__(self, certificate: str, key: str) -> None:
        self._certificate = read_certificate(certificate).public_bytes(Encoding.DER)
        self._key = read_key(key)

    def seal(self, key_expression: str, order: bytes) -> bytes:
        """Return the bytes that travel beside an order; empty for a node whose key is of a kind
        that signs none.

        Args:
            key_expression: on the bus, to which the order is sent.
            order: its bytes.
        """
        if not isinstance(self._key, Ed25519PrivateKey):
            return b""
        signature = self._key.sign(_signed(key_expression, order))
        return encode(OrderSeal(certificate=self._certificate, signature=signature))


class SealCheck:
    """Judges by whom an order was signed.

    Args:
        authority: path of the certificate of the fleet's authority.
    """

    def __init__(self, authority: str) -> None:
        self._authority = read_certificate(authority)
        self._known: dict[bytes, x509.Certificate] = {}  # issued by the authority
        self._true_nodes: dict[str, None] = {}  # nodes whose signature was right before
        # of this second, by node; "" for all that never signed rightly
        self._false_counts = Counter[str]()
        self._second = 0

    def refusal(
        self, key_expression: str, order: bytes, seal: bytes, now: datetime.datetime
    ) -> UntrustedOrder | None:
        """Judge an order.

        Args:
            key_expression: on the bus, at which it arrived.
            order: its bytes.
            seal: the bytes beside it; empty without.
            now: time at which the signer's certificate must be valid.
        Returns:
            None when a ground of this fleet has signed exactly this, for this vehicle; otherwise
            what is wrong.
        """
        read = decode(order, Order)
        node = "" if isinstance(read, Malformed) or read.node not in self._true_nodes else read.node
        found = self._fault_unless_flood(node, key_expression, order, seal, now)
        if found is None:
            if not isinstance(read, Malformed):
                self._remember(read.node)
            return None
        code, sentence = found
        if isinstance(read, Malformed):
            return UntrustedOrder(code, f"An order that cannot be read {sentence}")
        return UntrustedOrder(code, f"Order {read.text} {sentence}", read.order_id)

    def _remember(self, node: str) -> None:
        self._true_nodes.pop(node, None)
        if len(self._true_nodes) >= _MAX_KNOWN:
            self._true_nodes.pop(next(iter(self._true_nodes)))  # who has not ordered for longest
        self._true_nodes[node] = None

    def _fault_unless_flood(
        self, node: str, key_expression: str, order: bytes, seal: bytes, now: datetime.datetime
    ) -> tuple[RefusalCode, str] | None:
        """Judge an order unless too many false ones came within this second: each costs a
        verification.
        """
        second = int(now.timestamp())
        if second != self._second:
            self._second = second
            self._false_counts.clear()
        if self._false_counts[node] >= MOST_FALSE_PER_S:
            return (
                "flood",
                f"was not looked at: more than {MOST_FALSE_PER_S} false ones came within a second.",
            )
        found = self._fault(key_expression, order, seal, now)
        self._false_counts[node] += found is not None and found[0] != "unsigned"
        return found

    def _fault(
        self, key_expression: str, order: bytes, seal: bytes, now: datetime.datetime
    ) -> tuple[RefusalCode, str] | None:
        if not seal:
            return "unsigned", "is not signed: in a fleet with keys it is not obeyed."
        parts = decode(seal, OrderSeal)
        if isinstance(parts, Malformed):
            return "forged", f"has a signature that cannot be read ({parts.reason[:80]})."
        certificate = self._issued(parts.certificate)
        if certificate is None:
            return "foreign", "was signed by somebody whom this fleet's authority does not know."
        signer, public_key = common_name(certificate), certificate.public_key()
        first, last = certificate.not_valid_before_utc, certificate.not_valid_after_utc
        if not first <= now <= last:
            return "foreign", (
                f"was signed with a certificate of '{signer}' that is valid from {first:%Y-%m-%d} to {last:%Y-%m-%d}; "
                f"the vehicle's clock says {now:%Y-%m-%d}. Set the clock, or issue the certificate anew."
            )
        if signer != Role.GROUND:
            return "role", f"was signed by '{signer}', which may not order: only a ground may."
        try:
            if not isinstance(public_key, Ed25519PublicKey):
                raise InvalidSignature
            public_key.verify(parts.signature, _signed(key_expression, order))
        except InvalidSignature:
            return (
                "forged",
                "has a signature that does not fit: it was changed on its way, or is for another vehicle.",
            )
        return None

    def _issued(self, data: bytes) -> x509.Certificate | None:
        known = self._known.get(data)
        if known is not None:
            return known
        try:
            certificate = x509.load_der_x509_certificate(data)
            is_ours = issued_by(certificate, self._authority)
        except (ValueError, TypeError):
            return None
        if not is_ours:
            return None
        if len(self._known) >= _MAX_KNOWN:
            self._known.pop(next(iter(self._known)))
        self._known[data] = certificate
        return certificate


def _signed(key_expression: str, order: bytes) -> bytes:
    return _CONTEXT + key_expression.encode() + b"\0" + order
