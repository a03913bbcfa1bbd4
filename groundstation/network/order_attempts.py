"""Attempts with orders whose signature is wrong, or that arrive too late.

A node that forwards orders, such as a router, can change them, send them to another vehicle, sign
them with its own key or not at all, or keep them and send them later. It cannot sign them as the
ground does, because it does not hold the ground's key.

Each attempt is one such order to a flying vehicle. Its node connects with the ground's certificate,
so nothing on the bus stops the order. Only the vehicle's own check of signature and age does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from msgspec.structs import replace

from onboard.bus.control_token import parse_control_token
from onboard.bus.protocol import OrderSignatures, UntrustedOrder
from onboard.bus.schema import Order, Telemetry
from onboard.security.credentials import Credentials
from onboard.security.node_roles import NodeRole

# Returns the signature that travels with an order, given the order's key expression on the bus, the
# encoded order, and the true signatures.
Tamper = Callable[[str, bytes, OrderSignatures], bytes]

# Longer than an agent accepts an order: 5 s, and 30 s for an emergency (land, hold and kill).
_KEPT_S = 10.0
_KEPT_EMERGENCY_S = 40.0


@dataclass(frozen=True, slots=True)
class TamperedCredentials:
    """Credentials with the node's own certificate on the bus, but tampered signatures of orders.

    Args:
        own: credentials of the node.
        signer: credentials that sign its orders: its own, or those of another node.
        tamper: changes a signature.
    """

    own: Credentials
    signer: Credentials
    tamper: Tamper

    @property
    def authority(self) -> str:
        """Path of the certificate of the fleet's certificate authority."""
        return self.own.authority

    @property
    def certificate(self) -> str:
        """Path of the node's certificate."""
        return self.own.certificate

    @property
    def key(self) -> str:
        """Path of the node's private key."""
        return self.own.key

    @property
    def access(self) -> dict[str, object]:
        """Zenoh's ``access_control``: what the holder of each certificate may send."""
        return self.own.access

    def order_signatures(self) -> OrderSignatures:
        """Return the tampered signatures of this node's orders."""
        return _TamperedSignatures(self.signer.order_signatures(), self.tamper)


@dataclass(frozen=True, slots=True)
class _TamperedSignatures:
    genuine: OrderSignatures
    tamper: Tamper

    def seal(self, key_expression: str, order: bytes) -> bytes:
        return self.tamper(key_expression, order, self.genuine)

    def refusal(self, key_expression: str, order: bytes, seal: bytes) -> UntrustedOrder | None:
        return self.genuine.refusal(key_expression, order, seal)


def as_signed(key_expression: str, order: bytes, signatures: OrderSignatures) -> bytes:
    """Return the correct signature."""
    return signatures.seal(key_expression, order)


def without(_key_expression: str, _order: bytes, _signatures: OrderSignatures) -> bytes:
    """Return no signature."""
    return b""


def of_another_order(key_expression: str, order: bytes, signatures: OrderSignatures) -> bytes:
    """Return the signature of an order that differs in one byte, the last one."""
    changed = order[:-1] + bytes([order[-1] ^ 1])
    return signatures.seal(key_expression, changed)


def for_another_vehicle(key_expression: str, order: bytes, signatures: OrderSignatures) -> bytes:
    """Return the signature of the same order to another vehicle."""
    return signatures.seal(f"{key_expression}-other", order)


def unchanged(hold: Order, _last: Telemetry) -> Order:
    """Return the order as it is."""
    return hold


def kept_back(hold: Order, last: Telemetry) -> Order:
    """Return an order of the operator to locate the vehicle, as if it had been kept for 10 s.

    The age is the only reason to refuse it: a vehicle accepts `locate` from its operator's node.
    """
    node = hold.node
    operator = parse_control_token(last.operator)
    if operator is not None:
        node = operator.node
    heard_ns = last.stamp_ns - round(1e9 * _KEPT_S)
    return replace(hold, kind="locate", node=node, heard_ns=heard_ns)


def kept_back_emergency(hold: Order, last: Telemetry) -> Order:
    """Return the order to hold as if it had been kept for 40 s."""
    return replace(hold, heard_ns=last.stamp_ns - round(1e9 * _KEPT_EMERGENCY_S))


class OrderAttempt(NamedTuple):
    """One attempt with a wrongly signed or delayed order."""

    name: str
    tamper: Tamper  # changes the signature
    signer: NodeRole = NodeRole.GROUND  # role whose key signs
    # returns the order to sign, given a new one to hold and the vehicle's last telemetry
    change: Callable[[Order, Telemetry], Order] = unchanged


ORDER_ATTEMPTS = (
    OrderAttempt("an order without a signature", without),
    OrderAttempt("an order of which one byte was changed", of_another_order),
    OrderAttempt("an order that was signed for another vehicle", for_another_vehicle),
    OrderAttempt("an order that a viewer has signed", as_signed, signer=NodeRole.VIEWER),
    OrderAttempt("an order that was kept for 10 s", as_signed, change=kept_back),
    OrderAttempt("a hold that was kept for 40 s", as_signed, change=kept_back_emergency),
)
