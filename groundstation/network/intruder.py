"""Nodes of an intruder on the bus: without a key, with a wrong key, or with a stolen key.

The attempts of an attack (``attempts.py``) open these nodes on the bus of a fleet's copy.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import secrets
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from groundstation.keys.authority import issue, load_authority
from groundstation.keys.secured_fleet import secure_fleet
from groundstation.network.order_attempts import OrderAttempt, TamperedCredentials
from onboard.bus.protocol import NodeCredentials, OrderSignatures, UntrustedOrder
from onboard.bus.schema import Order, OrderKind, OrderReply, Telemetry
from onboard.bus.session import BusSession
from onboard.config.fleet import FleetConfig
from onboard.security.credentials import Credentials, credentials_of, files_of
from onboard.security.node_roles import NodeRole

# role -> a node name that the role may use
NODES = {
    NodeRole.GROUND: "ground-0-intruder",
    NodeRole.VIEWER: "watcher-0-intruder",
    NodeRole.MOCAP: "mocap",
    NodeRole.CORRECTIONS: "corrections",
    NodeRole.EMULATOR: "sitl",
}

# identities of outsiders, in words that end the names of attempts
NOBODY = "without a certificate"
FOREIGN = "with another authority's"
EXPIRED = "with an expired one"

_LONG_AGO = datetime.timedelta(days=2000)  # a certificate issued then has expired
_ORDER_DEADLINE_NS = 2_000_000_000
_POLL_S = 0.02


class _NoSignatures:
    """Signs no order, and accepts every order."""

    def seal(self, _key_expression: str, _order: bytes) -> bytes:
        return b""

    def refusal(self, _key_expression: str, _order: bytes, _seal: bytes) -> UntrustedOrder | None:
        return None


@dataclass(frozen=True, slots=True)
class _NoCertificate:
    """Credentials without a certificate of its own, but with that of the fleet's authority.

    The authority's certificate is not secret. Without it the intruder's own zenoh would not open
    the link, and the attempt would prove nothing.
    """

    authority: str
    certificate: str = ""
    key: str = ""
    access: dict[str, object] = field(default_factory=dict)

    def order_signatures(self) -> OrderSignatures:
        """Return signatures that are empty."""
        return _NoSignatures()


def _authority_path(fleet: FleetConfig) -> str:
    """Return the path of the certificate of a fleet's authority."""
    name, _, _ = files_of(fleet.enabled_names[0])
    return str(Path(fleet.keys_folder) / name)


@dataclass(frozen=True, slots=True)
class Intruders:
    """Makes intruders' nodes for one copy of a fleet; without keys all identities are alike."""

    fleet: FleetConfig
    folder: Path  # folder for the keys of outsiders

    @contextlib.contextmanager
    def node(
        self, identity: str, name: str, *vehicles: str, orders: OrderAttempt | None = None
    ) -> Iterator[BusSession]:
        """Open a node that connects to some vehicles.

        Args:
            identity: NOBODY, FOREIGN or EXPIRED, a role, or a vehicle whose key was stolen.
            name: name of the node.
            vehicles: names of the vehicles to which it connects.
            orders: changes the signatures of its orders; None: they are signed correctly.
        """
        credentials: NodeCredentials | None
        if identity == NOBODY and self.fleet.has_keys:
            credentials = _NoCertificate(authority=_authority_path(self.fleet))
        elif orders is not None:
            credentials = self._tampered_credentials(identity, orders)
        else:
            credentials = self._credentials(identity)
        session = BusSession(
            namespace=self.fleet.namespace,
            node=name,
            connect=[self.fleet.vehicles[vehicle].agent for vehicle in vehicles],
            credentials=credentials,
        )
        session.start()
        try:
            yield session
        finally:
            session.stop()

    def _credentials(self, identity: str) -> Credentials | None:
        if not self.fleet.has_keys:
            return None
        if identity == FOREIGN:
            return self._foreign_credentials()
        if identity == EXPIRED:
            return self._expired_credentials()
        return credentials_of(self.fleet, identity)

    def _tampered_credentials(
        self, identity: str, orders: OrderAttempt
    ) -> TamperedCredentials | None:
        """Return the credentials of a node whose orders have wrong signatures.

        Returns None if the fleet has no keys.
        """
        own = self._credentials(identity)
        signer = self._credentials(orders.signer)
        if own is None or signer is None:
            return None
        return TamperedCredentials(own=own, signer=signer, tamper=orders.tamper)

    @property
    def _victim(self) -> str:
        """The vehicle whose name outsiders use."""
        return self.fleet.enabled_names[-1]

    def _foreign_credentials(self) -> Credentials | None:
        """Return credentials of the victim's name from another authority, for an equal fleet."""
        copy = self.folder / "foreign" / "fleet.toml"
        if not copy.exists():
            copy.parent.mkdir()
            shutil.copy(self.fleet.path, copy)
        foreign_fleet = secure_fleet(str(copy), datetime.datetime.now(datetime.UTC))
        return credentials_of(foreign_fleet, self._victim)

    def _expired_credentials(self) -> Credentials | None:
        """Return the victim's credentials with an expired certificate."""
        folder = self.folder / "expired"
        folder.mkdir(exist_ok=True)

        victim = self._victim
        authority = load_authority(self.fleet)
        hosts = [self.fleet.vehicles[victim].host]
        long_ago = datetime.datetime.now(datetime.UTC) - _LONG_AGO
        issue(folder, authority, victim, hosts, long_ago)

        valid = credentials_of(self.fleet, victim)
        if valid is None:
            return None
        _, certificate, key = files_of(victim)
        return dataclasses.replace(
            valid, certificate=str(folder / certificate), key=str(folder / key)
        )


def order_of(node: BusSession, kind: OrderKind, telemetry: Telemetry | None = None) -> Order:
    """Return a new order of a node, as a ground would write it.

    Args:
        node: the node that will send it.
        kind: kind of the order.
        telemetry: the vehicle's last telemetry, to which the order refers; None if there is none.
    """
    now_ns = time.monotonic_ns()
    return Order(
        order_id=f"{node.node}-{secrets.token_hex(4)}",
        author="intruder",
        node=node.node,
        kind=kind,
        stamp_ns=now_ns,
        deadline_ns=now_ns + _ORDER_DEADLINE_NS,
        heard_boot_id=0 if telemetry is None else telemetry.boot_id,
        heard_ns=0 if telemetry is None else telemetry.stamp_ns,
    )


def is_obeyed(node: BusSession, vehicle: str, order: Order, timeout_s: float = 1.5) -> bool:
    """Send an order; return whether the vehicle accepts it."""
    replies: list[OrderReply] = []
    ended = threading.Event()

    def keep(reply: object) -> None:
        if isinstance(reply, OrderReply):
            replies.append(reply)

    node.order(vehicle, order, timeout_s=timeout_s, on_reply=keep, on_end=ended.set)
    ended.wait(timeout_s + 1.0)
    return any(reply.is_accepted for reply in replies)


def is_connected(node: BusSession, timeout_s: float = 2.0) -> bool:
    """Wait until a node sees another one; return whether it saw one in time."""
    seen = threading.Event()

    def on_alive(name: str, is_alive: bool) -> None:
        if is_alive and name != node.node:
            seen.set()

    node.watch_alive(on_alive)
    return seen.wait(timeout_s)


def until(condition: Callable[[], bool], timeout_s: float) -> bool:
    """Wait for a condition; return whether it came true."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        time.sleep(_POLL_S)
    return True
