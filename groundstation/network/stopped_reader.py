"""A viewer in a process of its own that subscribes to all topics: ``python -m ... FLEET``.

``covey check attack`` starts it, and then stops it by SIGSTOP, as Ctrl-Z would, while it reads.
"""

from __future__ import annotations

import sys
import threading

from groundstation.client.ground_node import session
from onboard.bus.control_token import WATCHER
from onboard.bus.topics import TOPICS, Delivery
from onboard.config.fleet import load_fleet

_FIRST_MESSAGE_S = 10.0  # longest wait for the first message


def main(fleet_path: str, first_message_s: float = _FIRST_MESSAGE_S) -> None:
    """Subscribe to all topics, print a line at the first message, and run until killed.

    Return if no message comes.

    Args:
        fleet_path: path of the fleet file.
        first_message_s: longest wait for the first message [s].
    """
    node = session(load_fleet(fleet_path), WATCHER)
    node.start()

    heard = threading.Event()
    for topic, spec in TOPICS.items():
        if spec.delivery in (Delivery.LATEST, Delivery.RELIABLE):
            node.subscribe(topic, "*", lambda *_: heard.set())

    if not heard.wait(first_message_s):
        node.stop()
        return

    print("reading", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main(sys.argv[1])
