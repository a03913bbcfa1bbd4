"""``covey keys``: the keys of a fleet's bus: its authority and the certificates of its nodes.

Examples:
  covey keys secure fleet.toml
  covey keys secure fleet.toml --mavlink
  covey keys list fleet.toml
  covey keys list fleet.toml --running
  covey keys issue fleet.toml mav3
  covey keys renew fleet.toml
  covey keys init fleet.toml --force

The authority signs the certificates of all nodes. covey keys secure makes what
is missing in keys/ beside the fleet file, and turns the fleet's endpoints into
quic/; a second call changes nothing. docs/keys.md says more. Exit status: 0 all
right; 1 covey keys list found a fault; 2 wrong input.
"""

from __future__ import annotations

import datetime
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from groundstation.commands.parameters import FileName
from groundstation.keys.authority import (
    AUTHORITY_KEY,
    folder_of,
    has_authority_key,
    load_authority,
    nodes_of,
)
from groundstation.keys.mavlink_keys import sign_mavlink
from groundstation.keys.running import running_authorities
from groundstation.keys.secured_fleet import (
    copied_files,
    has_issued,
    issue_all,
    refuse_example,
    renew_authority,
    secure_fleet,
)
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_NO_ANSWER, EXIT_OK
from onboard.security.certificate_times import end_words
from onboard.security.certificates import read_certificate
from onboard.security.credentials import credentials_of, files_of, hosts_of
from onboard.security.mavlink_key import key_file
from onboard.security.node_roles import ROUTER, NodeRole

# authority with which a node answers -> what covey keys list --running says about it
_RUNNING_WORDS = {
    "present": "runs with the present authority",
    "former": (
        "RUNS ON with a former authority, and hears nobody of the others: "
        "copy its files, and start it anew"
    ),
    "": "does not answer: it is off, not reached, or has keys that this computer does not know",
}

keys = App(name="keys", help="The keys of a fleet's bus.")
FleetArgument = Annotated[FileName, Parameter(name="FLEET")]
NodeArgument = Annotated[str, Parameter(name="NODE")]


@keys.command
def secure(fleet: FleetArgument, /, *, mavlink: bool = False) -> int:
    """Make keys for every node of a fleet, and turn its endpoints into endpoints with keys.

    Args:
        fleet: the fleet file; its folder gets a folder keys/
        mavlink: make the keys of MAVLink signing instead, between each vehicle's PX4 and all
            programs that speak to it
    """
    if mavlink:
        return _sign_mavlink(fleet)
    secured = secure_fleet(fleet, _now())
    file = Path(secured.path).name

    print(
        f"{secured.path}: every link of the bus is encrypted now, "
        "and both its ends prove who they are. Copy:"
    )
    for name, vehicle in secured.vehicles.items():
        print(f"  to {vehicle.host}: {file}, {_listed(copied_files(secured, name))}")
    print(f"  to your ground: {file}, {_listed(copied_files(secured, NodeRole.GROUND))}")
    for host in hosts_of(secured, ROUTER):
        print(f"  to {host}, for covey router: {file}, {_listed(copied_files(secured, ROUTER))}")
    print(
        "  to whoever only watches: the same with viewer; "
        "to the relay of a motion capture: with mocap"
    )
    if secured.corrections is not None:
        files = _listed(copied_files(secured, NodeRole.CORRECTIONS))
        print(f"  to the computer of covey corrections: {file}, {files}")
    print(f"{folder_of(secured) / 'ca.key'} makes new nodes: it stays here.")
    return EXIT_OK


def _sign_mavlink(path: str) -> int:
    """Make the keys of MAVLink signing, and print which computer gets which key."""
    signed = sign_mavlink(path)
    file = Path(signed.path).name

    print(f"{signed.path}: the vehicles sign their MAVLink now. Copy:")
    for name, vehicle in signed.vehicles.items():
        print(f"  to {vehicle.host}: {file}, {signed.fleet.keys}/{key_file(name)}")
    print("  to a ground that orders: all of them, for land and kill past an agent")

    command = shlex.join(["covey", "px4", "signing", "--set", "--fleet", path])
    print(f"Give each PX4 its key, with its agent stopped: {command}")
    return EXIT_OK


@keys.command
def init(fleet: FleetArgument, /, *, force: bool = False) -> int:
    """Make a new authority and reissue all certificates: whoever holds an older key is locked out.

    Args:
        fleet: the fleet file
        force: replace keys that are there
    """
    config = _loaded(fleet)
    folder = folder_of(config)
    if has_issued(config) and not force:
        raise ConfigError(
            f"{folder} has keys of this fleet. "
            "A new authority locks out every node until it has its new files: --force"
        )

    nodes = renew_authority(config, _now())
    print(
        f"New authority in {folder}, {len(nodes)} nodes issued. "
        "With all vehicles on the ground copy each"
    )
    print("node's files to its computer and start it anew: a node with older files finds nobody.")
    _print_if_open(config)
    return EXIT_OK


@keys.command
def issue(fleet: FleetArgument, /, *nodes: NodeArgument) -> int:
    """Issue key and certificate of a node; its former ones stay valid until they expire.

    Args:
        fleet: the fleet file
        nodes: vehicles, ground, viewer, mocap, sitl or router
    """
    config = _loaded(fleet)
    if not nodes:
        raise ConfigError(f"Which nodes? {', '.join(nodes_of(config))}.")
    return _issue(config, nodes)


@keys.command
def renew(fleet: FleetArgument, /) -> int:
    """Reissue the certificates of all nodes, by the same authority: before they expire, or after
    hosts changed.

    Args:
        fleet: the fleet file
    """
    config = _loaded(fleet)
    return _issue(config, nodes_of(config))


@keys.command(name="list")
def list_(fleet: FleetArgument, /, *, running: bool = False) -> int:
    """List the nodes: until when their certificates are valid, and what is wrong.

    Args:
        fleet: the fleet file
        running: also ask each running node whether its keys are of the present authority, or of a
            former one
    """
    config = load_fleet(fleet)
    if not config.has_keys:
        raise _without_keys(config)
    is_right = True
    for node in nodes_of(config):
        try:
            print(f"{node:12s} {_validity(config, node)}")
        except ConfigError as error:
            is_right = False
            print(f"{node:12s} {error}")

    try:
        key_place = "is on this computer: it makes new nodes"
        if not has_authority_key(config):
            key_place = "is not on this computer"
        print(f"{AUTHORITY_KEY:12s} {key_place}")
    except ConfigError as error:
        is_right = False
        print(f"{AUTHORITY_KEY:12s} {error}")

    if running:
        authorities = running_authorities(config)
        others = [node for node in authorities if node not in config.vehicles]
        for name in (*config.enabled_names, *others):
            print(f"{name:12s} {_RUNNING_WORDS[authorities.get(name, '')]}")
        if "former" in authorities.values():
            is_right = False
        if not authorities and is_right:
            return EXIT_NO_ANSWER
    return EXIT_OK if is_right else EXIT_FAILED


def _validity(config: FleetConfig, node: str) -> str:
    """Return in words until when a node's certificate is valid.

    Raises:
        ConfigError: certificate or key is not valid.
    """
    folder = folder_of(config)
    _, certificate, key = (folder / name for name in files_of(node))
    if not certificate.exists():
        return "not on this computer"

    remark = "; its key is not on this computer"
    if key.exists():
        remark = ""
        credentials_of(config, node, _now())
    until = read_certificate(str(certificate)).not_valid_after_utc
    return f"valid until {end_words(until, _now())}{remark}"


def _issue(config: FleetConfig, nodes: Sequence[str]) -> int:
    issue_all(config, load_authority(config), nodes, _now())
    print(f"Issued in {folder_of(config)}: {', '.join(nodes)}.")
    _print_if_open(config)
    return EXIT_OK


def _listed(files: Sequence[str]) -> str:
    return ", ".join(files)


def _loaded(fleet: str) -> FleetConfig:
    """Return a fleet whose bus has keys, or whose folder has keys for it.

    Raises:
        ConfigError: there are no keys, or the fleet is an example, which gets none.
    """
    config = load_fleet(fleet)
    refuse_example(config)
    if not config.has_keys and not has_issued(config):
        raise _without_keys(config)
    return config


def _without_keys(config: FleetConfig) -> ConfigError:
    return ConfigError(
        f"{config.path}: the bus of this fleet has no keys. "
        f"Lock it: covey keys secure {config.path}"
    )


def _print_if_open(config: FleetConfig) -> None:
    """Print that the bus does not use the keys, if the fleet file has endpoints without keys."""
    if not config.has_keys:
        print(f"The bus is still open to everybody. Lock it: covey keys secure {config.path}")


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)
