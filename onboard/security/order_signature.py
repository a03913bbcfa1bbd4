"""Signatures of orders. With them, a vehicle knows which node signed an order, even behind a
router.

Behind a router, a vehicle's link shows the router's certificate, not the ground's. So the ground
signs each order with the key of its certificate (Ed25519). It sends the signature and the
certificate beside the order. Together they are the order's seal.

The signature also covers the order's key on the bus, which contains the fleet and the vehicle. So
an order for one vehicle is not valid for another.

Verifying costs time, so only a limited number of false orders is verified per second. False orders
are counted separately for each ground that has sent a valid order before, by the name in the
order. So a flood from other senders does not block such a ground; a sender that takes its name
does.
"""

from __future__ import annotations

import datetime
from collections import Counter

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding

from onboard.bus.codec import Malformed, decode, encode
from onboard.bus.protocol import RefusalCode, UntrustedOrder
from onboard.bus.schema import Message, Order
from onboard.security.certificates import (
    NO_CERTIFICATE,
    common_name,
    issued_by,
    read_certificate,
    read_key,
)
from onboard.security.node_roles import NodeRole

_CONTEXT = b"covey order 1\0"  # signed too, so that no signature for another purpose fits an order
MAX_FALSE_PER_S = 200  # at most this many false orders per counted sender are verified per second
_BEGIN_FLIGHTS = ("arm", "takeoff")  # orders that are refused once the certificate has expired
_MAX_KNOWN = 16  # number of remembered certificates, and of remembered grounds with valid orders
_UNKNOWN_NODE = ""  # the false orders of all other senders are counted under this name

_Fault = tuple[RefusalCode, str]  # code, and the end of a sentence that begins with the order


class OrderSeal(Message, frozen=True, array_like=True, kw_only=True):
    """Certificate and signature, which are sent beside an order."""

    certificate: bytes  # signer's certificate, DER
    signature: bytes  # over the order's key on the bus and the order's bytes


class NodeSignatures:
    """Signs the orders that a node sends, and verifies the orders that it receives.

    Args:
        authority: path of the certificate of the fleet's certificate authority.
        certificate: path of the node's certificate.
        key: path of the node's private key.
        grace_s: see :class:`SealCheck`.
    """

    def __init__(self, authority: str, certificate: str, key: str, *, grace_s: float = 0.0) -> None:
        self._signer = OrderSigner(certificate, key)
        self._check = SealCheck(authority, grace_s)

    def seal(self, key_expression: str, order: bytes) -> bytes:
        """Return the seal of an order, like :meth:`OrderSigner.seal`."""
        return self._signer.seal(key_expression, order)

    def refusal(self, key_expression: str, order: bytes, seal: bytes) -> UntrustedOrder | None:
        """Verify an order that has just arrived, like :meth:`SealCheck.refusal`."""
        now = datetime.datetime.now(datetime.UTC)
        return self._check.refusal(key_expression, order, seal, now)


class OrderSigner:
    """Signs orders with a node's key.

    Args:
        certificate: path of the node's certificate, which has been checked.
        key: path of the node's private key.
    """

    def __init__(self, certificate: str, key: str) -> None:
        self._certificate = read_certificate(certificate).public_bytes(Encoding.DER)
        self._key = read_key(key)

    def seal(self, key_expression: str, order: bytes) -> bytes:
        """Return the seal of an order.

        Args:
            key_expression: key of the bus to which the order is sent.
            order: bytes of the order.
        Returns:
            bytes of an :class:`OrderSeal`; empty if the node's key is not an Ed25519 key.
        """
        if not isinstance(self._key, Ed25519PrivateKey):
            return b""
        signature = self._key.sign(_signed_bytes(key_expression, order))
        return encode(OrderSeal(certificate=self._certificate, signature=signature))


class SealCheck:
    """Verifies that a ground of the fleet has signed an order.

    Args:
        authority: path of the certificate of the fleet's certificate authority.
        grace_s: time [s] for which a ground's orders stay valid after its certificate has
            expired, except orders that start a flight.
    """

    def __init__(self, authority: str, grace_s: float = 0.0) -> None:
        self._authority = read_certificate(authority)
        self._grace = datetime.timedelta(seconds=grace_s)

        # DER bytes -> certificate that the authority has issued
        self._issued_certificates: dict[bytes, x509.Certificate] = {}

        # nodes that have sent valid orders, in the order of their last valid order, oldest first; a
        # dict, because a set is unordered
        self._nodes_with_valid_orders: dict[str, None] = {}

        # node -> number of its false orders within the present second
        self._false_counts = Counter[str]()
        self._second = 0

    def refusal(
        self, key_expression: str, order: bytes, seal: bytes, now: datetime.datetime
    ) -> UntrustedOrder | None:
        """Verify an order.

        Args:
            key_expression: key of the bus at which the order arrived.
            order: bytes of the order.
            seal: bytes of the seal; empty if the order came without a seal.
            now: time at which the signer's certificate must be valid.
        Returns:
            None if a ground of this fleet has signed exactly this order for this vehicle; otherwise
            the refusal.
        """
        read_order = decode(order, Order)

        claimed_node = _UNKNOWN_NODE
        if (
            not isinstance(read_order, Malformed)
            and read_order.node in self._nodes_with_valid_orders
        ):
            claimed_node = read_order.node

        fault = self._fault_unless_flood(claimed_node, key_expression, order, seal, now)
        if fault is None:
            if not isinstance(read_order, Malformed):
                self._remember_node(read_order.node)
            return None

        code, sentence = fault
        if isinstance(read_order, Malformed):
            return UntrustedOrder(code, f"An order that cannot be read {sentence}")
        return UntrustedOrder(code, f"Order {read_order.text} {sentence}", read_order.order_id)

    def _remember_node(self, node: str) -> None:
        """Add a node that has sent a valid order; forget the oldest if there are too many."""
        self._nodes_with_valid_orders.pop(node, None)
        if len(self._nodes_with_valid_orders) >= _MAX_KNOWN:
            oldest = next(iter(self._nodes_with_valid_orders))
            del self._nodes_with_valid_orders[oldest]
        self._nodes_with_valid_orders[node] = None

    def _fault_unless_flood(
        self,
        claimed_node: str,
        key_expression: str,
        order: bytes,
        seal: bytes,
        now: datetime.datetime,
    ) -> _Fault | None:
        """Return the fault of an order. After too many false orders, do not verify it."""
        second = int(now.timestamp())
        if second != self._second:
            self._second = second
            self._false_counts.clear()

        if self._false_counts[claimed_node] >= MAX_FALSE_PER_S:
            return (
                "flood",
                f"was not looked at: more than {MAX_FALSE_PER_S} false ones came within a second.",
            )

        fault = self._fault(key_expression, order, seal, now)
        if fault is not None:
            code, _ = fault
            if code != "unsigned":  # an order without a seal needs no verification
                self._false_counts[claimed_node] += 1
        return fault

    def _fault(
        self, key_expression: str, order: bytes, seal: bytes, now: datetime.datetime
    ) -> _Fault | None:
        """Return the fault of an order, or None. The cheapest checks come first."""
        if not seal:
            return "unsigned", "is not signed: in a fleet with keys it is not obeyed."

        parts = decode(seal, OrderSeal)
        if isinstance(parts, Malformed):
            return "forged", f"has a signature that cannot be read ({parts.reason[:80]})."

        certificate = self._issued_certificate(parts.certificate)
        if certificate is None:
            return "foreign", "was signed by somebody whom this fleet's authority does not know."

        signer = common_name(certificate)
        first = certificate.not_valid_before_utc
        last = certificate.not_valid_after_utc
        usable_until = last
        if not _begins_flight(order):
            usable_until = last + self._grace
        if not first <= now <= usable_until:
            return "foreign", (
                f"was signed with a certificate of '{signer}' that is valid from "
                f"{first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M} UTC; the vehicle's clock says "
                f"{now:%Y-%m-%d %H:%M}. Set the clock, or issue the certificate anew."
            )
        if signer != NodeRole.GROUND:
            return "role", f"was signed by '{signer}', which may not order: only a ground may."

        public_key = certificate.public_key()
        try:
            if not isinstance(public_key, Ed25519PublicKey):
                raise InvalidSignature
            public_key.verify(parts.signature, _signed_bytes(key_expression, order))
        except InvalidSignature:
            return "forged", (
                "has a signature that does not fit: it was changed on its way, or is for another "
                "vehicle."
            )
        return None

    def _issued_certificate(self, der: bytes) -> x509.Certificate | None:
        """Return a certificate from its DER bytes; None if the authority has not issued it."""
        known = self._issued_certificates.get(der)
        if known is not None:
            return known

        try:
            certificate = x509.load_der_x509_certificate(der)
        except NO_CERTIFICATE:
            return None
        if not issued_by(certificate, self._authority):
            return None

        if len(self._issued_certificates) >= _MAX_KNOWN:
            oldest = next(iter(self._issued_certificates))
            del self._issued_certificates[oldest]
        self._issued_certificates[der] = certificate
        return certificate


def _begins_flight(order: bytes) -> bool:
    """Return whether an order arms or takes off; also True if it cannot be read."""
    read_order = decode(order, Order)
    return isinstance(read_order, Malformed) or read_order.kind in _BEGIN_FLIGHTS


def _signed_bytes(key_expression: str, order: bytes) -> bytes:
    return _CONTEXT + key_expression.encode() + b"\0" + order
