"""This ground's node on the bus, and the name of the person at this computer."""

from __future__ import annotations

import getpass
import os

from groundstation.orders.plan import random_id
from onboard.bus.control_token import GROUND
from onboard.bus.session import BusSession
from onboard.config.fleet import FleetConfig
from onboard.security.credentials import credentials_of, files_of
from onboard.security.node_roles import NodeRole


def session(
    fleet: FleetConfig,
    role: str = GROUND,
    key_of: NodeRole | None = None,
    router_timeout_s: float = 10.0,
) -> BusSession:
    """Return a new node on the fleet's bus.

    Args:
        fleet: fleet whose agents the node connects to.
        role: GROUND for a node that may order, WATCHER for one that only watches.
        key_of: owner of the key that the node uses on a locked bus; None for the key that fits
            ``role``.
        router_timeout_s: time for which the node looks for a router when it is started [s].

    Returns:
        The node, which is not started yet.
    """
    return BusSession(
        namespace=fleet.namespace,
        node=f"{role}-{os.getpid()}-{random_id()[:4]}",
        connect=[*(vehicle.agent for vehicle in fleet.vehicles.values()), *fleet.pose_endpoints],
        credentials=credentials_of(fleet, key_of or _fitting_key(fleet, role)),
        routers=fleet.fleet.routers,
        router_timeout_s=router_timeout_s,
    )


def _fitting_key(fleet: FleetConfig, role: str) -> NodeRole:
    """Return the role whose key this ground uses.

    A ground that only watches uses the key for orders if there is no key for watching.
    """
    viewer_certificate = os.path.join(fleet.keys_folder, files_of(NodeRole.VIEWER).certificate)
    if role != GROUND and os.path.exists(viewer_certificate):
        return NodeRole.VIEWER
    return NodeRole.GROUND


def user_name() -> str:
    """Return the name of the user of this process, or ``uid-`` and the user's number."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"uid-{os.getuid()}"
