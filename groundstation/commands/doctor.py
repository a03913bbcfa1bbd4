"""``covey check computer``: whether this computer and the fleet's network are fit to fly.

Examples:
  covey check computer
  covey check computer fleet.toml
  covey check computer fleet.toml --network
  covey check computer fleet.toml --network --json

It changes nothing and orders nothing. Whether a fleet can fly as its file says:
covey check FLEET; whether each vehicle may take off: covey check vehicles.

Exit status: 0 no FAIL; 1 at least one; 2 wrong input; 10 nobody answered.
"""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import FileName, Seconds
from groundstation.network.diagnosis import Grade, as_json, as_text, worst
from groundstation.network.key_checks import authority_check, key_checks
from groundstation.network.link_checks import judged, listen
from groundstation.network.machine import machine
from groundstation.network.network_interfaces import interfaces
from onboard.config.fleet import ConfigError, load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_NO_ANSWER, EXIT_OK

_LONGEST_S = 600.0


def doctor(
    fleet: Annotated[FileName | None, Parameter(name="FLEET")] = None,
    /,
    *,
    network: bool = False,
    seconds: Seconds = 5.0,
    json: bool = False,
) -> int:
    """Say whether this computer is fit, and with --network whether the links between all nodes are.

    Each line about a fault says what to do.

    Args:
        fleet: the fleet file
        network: listen to all running nodes: rates, losses, ages, round trips, clocks
        seconds: listen for this time
        json: a list with an object for each line
    """
    config = None if fleet is None else load_fleet(fleet)
    if network and config is None:
        raise ConfigError("--network needs the fleet file: covey check computer FLEET --network")
    if not 1.0 <= seconds <= _LONGEST_S:
        raise ConfigError(f"--seconds is {seconds:g}; give 1 to {_LONGEST_S:g}.")

    lines = machine()
    is_silent = False
    if config is not None:
        lines += key_checks(config)
        if network:
            heard = listen(config, seconds)
            is_silent = not heard.last  # no message of any node
            lines += interfaces()
            lines += judged(config, heard)
            if config.has_keys:
                lines.append(authority_check(config))

    print(as_json(lines) if json else as_text(lines))
    if is_silent:
        return EXIT_NO_ANSWER
    return EXIT_FAILED if worst(lines) is Grade.FAIL else EXIT_OK
