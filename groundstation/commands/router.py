"""``covey router``: a router of the fleet's bus, with the endpoints and keys of the fleet file.

Examples:
  covey router fleet.toml
  covey router fleet.toml --endpoint quic/10.0.0.5:7447
  covey router north.toml south.toml
  covey router fleet.toml --print-config > router.json5 && zenohd --config router.json5

It runs until Ctrl-C. docs/network.md says when a fleet wants routers.

Exit status: 0 stopped; 2 wrong input.
"""

from __future__ import annotations

import signal
import sys
import threading
from json import dumps
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import FileName
from onboard.bus.router import Router, router_endpoint, router_settings
from onboard.bus.zenoh_settings import nested
from onboard.config.fleet import load_fleet
from onboard.end_signals import end_signals
from onboard.exit_status import EXIT_FAILED, EXIT_OK
from onboard.security.certificate_ends import links_left_s
from onboard.security.credentials import router_credentials
from onboard.security.node_roles import ROUTER


def router(
    *fleets: Annotated[FileName, Parameter(name="FLEET", required=True)],
    endpoint: Annotated[str | None, Parameter(metavar="ENDPOINT")] = None,
    print_config: bool = False,
) -> int:
    """Pass on the messages of one or several fleets, whose files name this router.

    Args:
        fleets: fleet files; several fleets share a router and hear nothing of each other
        endpoint: which one of fleet.routers this is (default: the one of this computer)
        print_config: only print the configuration, for Zenoh's own zenohd
    """
    loaded = [load_fleet(path) for path in fleets]
    own_endpoint = router_endpoint(loaded, endpoint)
    settings = router_settings(loaded, own_endpoint, router_credentials(loaded))
    if print_config:
        print(dumps(nested(settings), indent=2))
        return EXIT_OK

    stopped = threading.Event()
    for number in end_signals():  # all end the router cleanly
        signal.signal(number, lambda *_: stopped.set())

    node = Router(settings)
    node.start()
    setting_of = dict(settings)
    (listening,) = _bare(setting_of["listen/endpoints"])
    others = ", ".join(_bare(setting_of["connect/endpoints"])) or "no other"
    names = ", ".join(fleet.fleet.name for fleet in loaded)
    print(f"router: {listening} for {names}; other routers: {others}. Ctrl-C ends.", flush=True)

    left_s = links_left_s(loaded, ROUTER)
    if left_s is not None:
        left_s = min(left_s, threading.TIMEOUT_MAX)
    is_asked_to_stop = stopped.wait(left_s)
    node.stop()
    if is_asked_to_stop:
        return EXIT_OK
    print("router: its certificate has ended: all links are closed now.", file=sys.stderr)
    return EXIT_FAILED


def _bare(endpoints: list[str]) -> list[str]:
    """Return endpoints without the settings of their links."""
    return [endpoint.partition("?")[0] for endpoint in endpoints]
