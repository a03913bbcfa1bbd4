"""One node of the benchmark, in a network namespace: publishes states at 50 Hz, or says how old the
newest ones are.
"""

from __future__ import annotations

import json
import socket
import sys
import time

from tests.bench.network import namespaces

PERIOD_S = 0.02
_SETTLE_S = 2.0


def main(words: list[str]) -> int:
    """Run as ``name fleet-file address seconds socket``; the vehicle named first publishes, the
    other listens.
    """
    name, path, address, seconds, descriptor = words
    tun = namespaces.enter(address)  # before any library starts a thread
    parent = socket.socket(fileno=int(descriptor))
    socket.send_fds(parent, [b"tun"], [tun])
    parent.recv(1)  # the link carries packets

    from onboard.bus.codec import Malformed
    from onboard.bus.schema import Message, StateMessage
    from onboard.bus.session import BusSession
    from onboard.bus.topics import Topic
    from onboard.config.fleet import load_fleet
    from onboard.security.credentials import credentials_of
    from tests.onboard.state_messages import state_message

    fleet = load_fleet(path)
    publisher, listener = fleet.vehicles
    bus = BusSession(
        namespace=fleet.namespace,
        node=name,
        listen=[fleet.vehicles[name].agent] if name == publisher else [],
        connect=[fleet.vehicles[publisher].agent] if name == listener else [],
        credentials=credentials_of(fleet, name),
    )
    bus.start()
    newest_ns = 0
    ages_ms = list[float]()
    count = 0

    def received(_topic: Topic, _name: str, message: Message | Malformed) -> None:
        nonlocal newest_ns, count
        if isinstance(message, StateMessage):
            newest_ns = max(newest_ns, message.stamp_ns)
            count = count + 1

    if name == listener:
        bus.follow(Topic.STATE, [publisher], received)
    begin_s = time.monotonic()
    first_s = 0.0
    sequence = 0
    while not (first_s and time.monotonic() - first_s > float(seconds) + _SETTLE_S):
        sequence += 1
        now_ns = time.monotonic_ns()
        if name == publisher:
            bus.publish(
                Topic.STATE, name, state_message(vehicle=name, sequence=sequence, stamp_ns=now_ns)
            )
            if now_ns * 1e-9 - begin_s > float(seconds) + 20.0:
                break
        else:
            bus.deliver()
            if newest_ns and not first_s:
                first_s = time.monotonic()
                parent.send(b"h")
            if first_s and time.monotonic() - first_s > _SETTLE_S:
                ages_ms.append((now_ns - newest_ns) * 1e-6)
            if time.monotonic() - begin_s > float(seconds) + 20.0:
                break
        time.sleep(max(0.0, begin_s + sequence * PERIOD_S - time.monotonic()))
    if name == listener:
        opened_s = first_s - begin_s if first_s else None
        found = {"ages_ms": ages_ms, "messages": count, "opened_s": opened_s}
        print(json.dumps(found), flush=True)
    bus.stop()
    parent.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
