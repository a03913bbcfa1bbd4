"""Somebody on the network who has no key, or the wrong one, or the right one of another role."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import secrets
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from groundstation.keys.authority import issue, load_authority
from groundstation.keys.secured_fleet import secure_fleet
from onboard.bus.schema import Order, OrderKind, OrderReply, Telemetry
from onboard.bus.session import BusSession
from onboard.config.fleet import FleetConfig
from onboard.security.credentials import Credentials, credentials_of, files_of
from onboard.security.node_roles import NodeRole

# node names that the tokens and the clocks of a role may have
NODES = {
    NodeRole.GROUND: "ground-0-intruder",
    NodeRole.VIEWER: "watcher-0-intruder",
    NodeRole.MOCAP: "mocap",
    NodeRole.EMULATOR: "sitl",
}
NOBODY, FOREIGN, EXPIRED = (
    "without a certificate",
    "with another authority's",
    "with an expired one",
)
_LONG_AGO = datetime.timedelta(days=2000)


@dataclass(frozen=True, slots=True)
class Intruders:
    """Makes intruders for one copy of a fleet; on one without keys all of them are nobody."""

    fleet: FleetConfig
    folder: Path  # for the keys of those from outside

    @contextlib.contextmanager
    def node(self, who: str, name: str, *vehicles: str) -> Iterator[BusSession]:
        """Open a node that connects to some vehicles.

        Args:
            who: one of the outsiders, a role, or a vehicle whose key was taken.
            name: of the node.
            vehicles: to connect to.
        """
        session = BusSession(
            namespace=self.fleet.namespace,
            node=name,
            connect=[self.fleet.vehicles[vehicle].agent for vehicle in vehicles],
            credentials=self._credentials(who),
        )
        session.start()
        try:
            yield session
        finally:
            session.stop()

    def _credentials(self, who: str) -> Credentials | None:
        if not self.fleet.has_keys or who == NOBODY:
            return None
        victim = self.fleet.enabled_names[-1]
        if who == FOREIGN:
            copy = self.folder / "foreign" / "fleet.toml"
            if not copy.exists():
                copy.parent.mkdir()
                shutil.copy(self.fleet.path, copy)
            return credentials_of(
                secure_fleet(str(copy), datetime.datetime.now(datetime.UTC)), victim
            )
        if who == EXPIRED:
            keys, folder = Path(self.fleet.keys_folder), self.folder / "expired"
            folder.mkdir(exist_ok=True)
            long_ago = datetime.datetime.now(datetime.UTC) - _LONG_AGO
            issue(
                folder, load_authority(keys), victim, [self.fleet.vehicles[victim].host], long_ago
            )
            _, certificate, key = (str(folder / file) for file in files_of(victim))
            valid = credentials_of(self.fleet, victim)
            return valid and dataclasses.replace(valid, certificate=certificate, key=key)
        return credentials_of(self.fleet, who)


def order_of(node: BusSession, kind: OrderKind, last: Telemetry | None = None) -> Order:
    """Return a new order of a node, as a ground would write it that has heard this telemetry."""
    now_ns = time.monotonic_ns()
    return Order(
        order_id=f"{node.node}-{secrets.token_hex(4)}",
        author="intruder",
        node=node.node,
        kind=kind,
        stamp_ns=now_ns,
        deadline_ns=now_ns + 2_000_000_000,
        heard_boot_id=0 if last is None else last.boot_id,
        heard_ns=0 if last is None else last.stamp_ns,
    )


def is_obeyed(node: BusSession, vehicle: str, order: Order, timeout_s: float = 1.5) -> bool:
    """Send an order; whether the vehicle accepts it."""
    replies: list[OrderReply] = []
    ended = threading.Event()

    def keep(reply: object) -> None:
        if isinstance(reply, OrderReply):
            replies.append(reply)

    node.order(vehicle, order, timeout_s=timeout_s, on_reply=keep, on_end=ended.set)
    ended.wait(timeout_s + 1.0)
    return any(reply.is_accepted for reply in replies)


def is_connected(node: BusSession, timeout_s: float = 2.0) -> bool:
    """Wait until a node sees another one; False when it does not."""
    seen = threading.Event()
    node.watch_alive(lambda name, is_alive: seen.set() if is_alive and name != node.node else None)
    return seen.wait(timeout_s)


def until(condition: Callable[[], bool], timeout_s: float) -> bool:
    """Wait for a condition; whether it came true."""
    end_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.02)
    return True
