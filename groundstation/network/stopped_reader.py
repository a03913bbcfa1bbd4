"""A viewer in a process of its own that hears everything, to be stopped: ``python -m ... FLEET``,
for covey check attack.
"""

from __future__ import annotations

import sys
import threading

from groundstation.client.ground_node import session
from onboard.bus.control_token import WATCHER
from onboard.bus.topics import TOPICS, Delivery
from onboard.config.fleet import load_fleet


def main(fleet_path: str) -> None:
    """Subscribe to everything, say so when something has come, and go on until it is ended."""
    node, heard = session(load_fleet(fleet_path), WATCHER), threading.Event()
    node.start()
    for topic, spec in TOPICS.items():
        if spec.delivery in (Delivery.LATEST, Delivery.RELIABLE):
            node.subscribe(topic, "*", lambda *_: heard.set())
    if heard.wait(10.0):
        print("reading", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main(sys.argv[1])
