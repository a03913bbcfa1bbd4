"""``covey doctor``: whether this computer, and the network between all nodes that run, are fit to
fly.

Examples:
  covey doctor
  covey doctor fleet.toml
  covey doctor fleet.toml --network
  covey doctor fleet.toml --network --json

It changes nothing and orders nothing. Whether a fleet can fly as its file says: covey check;
whether each vehicle may take off: covey preflight. Exit status: 0 no FAIL; 1 at least one; 2 wrong
input; 10 nobody answered.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.network.diagnosis import (
    Diagnosis,
    Grade,
    as_json,
    as_text,
    graded,
    worst,
)
from groundstation.commands.network.links import judged, listen
from groundstation.commands.network.machine import interfaces, machine
from groundstation.commands.parameters import Seconds
from groundstation.keys.authority import folder_of, nodes_of
from groundstation.keys.running import running_authorities
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_NO_ANSWER, EXIT_OK
from onboard.security.certificates import read_certificate
from onboard.security.credentials import credentials_of, files_of

_SOON = datetime.timedelta(days=30)
_LONGEST_S = 600.0


def doctor(
    fleet: Annotated[str | None, Parameter(name="FLEET")] = None,
    /,
    *,
    network: bool = False,
    seconds: Seconds = 5.0,
    json: bool = False,
) -> int:
    """Say whether this computer is fit, and with --network whether the fleet's links are, and what
    to do about it.

    Args:
        fleet: the fleet file
        network: listen to all nodes that run: rates, losses, ages, round trips, clocks
        seconds: listen for so long
        json: a list with an object for each line
    """
    config = None if fleet is None else load_fleet(fleet)
    if network and config is None:
        raise ConfigError("--network needs the fleet file: covey doctor FLEET --network")
    if not 1.0 <= seconds <= _LONGEST_S:
        raise ConfigError(f"--seconds is {seconds:g}; give 1 to {_LONGEST_S:g}.")
    found, is_silent = machine(), False
    if config is not None:
        found += _keys(config)
    if config is not None and network:
        heard = listen(config, seconds)
        is_silent = not heard.last
        found += [*interfaces(), *judged(config, heard)]
        found += _authorities(config) if config.has_keys else ()
    print(as_json(found) if json else as_text(found))
    if is_silent:
        return EXIT_NO_ANSWER
    return EXIT_FAILED if worst(found) is Grade.FAIL else EXIT_OK


def _authorities(fleet: FleetConfig) -> Iterator[Diagnosis]:
    """Yield who runs on with an authority that was replaced."""
    former = [
        node for node, authority in running_authorities(fleet).items() if authority == "former"
    ]
    text = f"Run on with a former authority: {', '.join(former) or 'none of those that answer'}."
    yield graded(
        "authority",
        not former,
        text,
        "Copy their new files, and start them anew: docs/keys.md",
        bad=Grade.FAIL,
    )


def _keys(fleet: FleetConfig) -> Iterator[Diagnosis]:
    """Yield whether the keys that are on this computer fit."""
    if not fleet.has_keys:
        text = "This fleet's bus has none. On one computer it needs none."
        yield Diagnosis("keys", Grade.OK, text, "On a network: covey secure FLEET")
        return
    now = datetime.datetime.now(datetime.UTC)
    folder, ends = folder_of(fleet), {}
    for node in nodes_of(fleet):
        _, certificate, key = (folder / name for name in files_of(node))
        if key.exists():
            try:
                credentials_of(fleet, node, now)
                ends[node] = read_certificate(str(certificate)).not_valid_after_utc
            except ConfigError as error:
                yield Diagnosis(f"keys of {node}", Grade.FAIL, str(error))
    if not ends:
        yield Diagnosis(
            "keys", Grade.FAIL, f"No key in {folder} is good.", "Copy this node's: docs/keys.md"
        )
        return
    first = min(ends, key=ends.__getitem__)
    text = f"Of {', '.join(ends)}; the first to expire is {first}'s, {ends[first]:%Y-%m-%d}."
    yield graded("keys", ends[first] - now > _SOON, text, "covey keys renew FLEET, and copy them")
