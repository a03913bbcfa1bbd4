"""``covey check attack``: attempts to get into an emulated copy of a fleet while the copy flies.

Examples:
  covey check attack fleet.toml
  covey check attack paper --long
  covey check attack fleet.toml --only "an order"
  covey check attack fleet.toml --json

With --long, a simulation also tries 1000 false reports and spoofings by one
member, and searches for those that bring the others nearest to each other.

The copy has its own ports, folder and keys, so a fleet that runs already is not
touched. Each attempt is made twice: on a copy with keys, and on a copy without
keys. On the second one it must succeed; otherwise it proves nothing.
docs/threats.md says what is not tried. Exit status: 0 nothing got in; 1
something got in, or an attempt proved nothing; 2 wrong input; 130 interrupted.
"""

from __future__ import annotations

from json import dumps
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import FileName
from groundstation.network.attack import attack_copies
from onboard.config.fleet import load_fleet
from onboard.exit_status import EXIT_FAILED, EXIT_OK
from sitl.monte_carlo.campaign_settings import setup_for
from sitl.monte_carlo.lie_search import SearchReport, search

_SEARCH_FLIGHTS = 1000  # flights with false reports and spoofings by one member ("lies")


def attack(
    fleet: Annotated[FileName, Parameter(name="FLEET")],
    /,
    *,
    long: bool = False,
    only: str = "",
    json: bool = False,
) -> int:
    """Try to get into an emulated copy of a fleet, from outside and inside; say what got in.

    The copy flies meanwhile.

    Args:
        fleet: the fleet file
        long: floods and bad frames for minutes instead of seconds, and the search for lies
        only: make only attempts whose name contains this; by default all
        json: one object instead of lines
    """

    def say(line: str) -> None:
        if not json:
            print(line, flush=True)

    report = attack_copies(load_fleet(fleet), is_long=long, only=only, say=say)
    lies: SearchReport | None = None
    if long and not only:
        say("\nLies of one member are searched.")
        lies = search(setup_for(fleet_path=str(fleet)), tries=_SEARCH_FLIGHTS, say=say)

    if json:
        values = report.as_mapping()
        if lies is not None:
            values["lies"] = lies.as_mapping()
        print(dumps(values, indent=2))
    else:
        print(report.as_text())
        if lies is not None:
            print("\n".join(lies.lines))

    is_right = report.is_right and (lies is None or lies.is_right)
    return EXIT_OK if is_right else EXIT_FAILED
