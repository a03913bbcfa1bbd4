"""The stream stays with the first sender, for good."""

from __future__ import annotations

from sitl.conformance.facts import FactReport, facts
from sitl.conformance.phase import Phase
from sitl.conformance.vehicle_client import VehicleClient

FACTS = facts("lock", "facts")


def run(client: VehicleClient, report: FactReport) -> None:
    """Speak for the first time, from one port or the other, then from both."""
    if client.moves_first_sender:
        _from_elsewhere(client, report)
        return
    report.skip(FACTS[1:], "it leaves the vehicle locked to a port that is gone: see --from-elsewhere")
    client.greet(as_ground_station=False)
    client.spend(0.5)
    stranger = client.port.stranger()
    try:
        for _ in range(3):
            stranger.send(client.pack_heartbeat())
            client.spend(0.3)
        got = stranger.receive(0.0)
        client.spend(0.3)
        report.add("link.second-sender", "moves" if got or stranger.receive(0.0) else "stays")
    finally:
        stranger.close()


def _from_elsewhere(client: VehicleClient, report: FactReport) -> None:
    listener, stranger = client.port, client.port.stranger()
    client.port = stranger
    client.greet(as_ground_station=False)
    client.spend(0.6)
    listener.receive(0.0)
    client.spend(0.4)
    moved = not listener.receive(0.0)
    report.add("link.first-sender", "moves there" if moved else "stays")
    for _ in range(3):
        listener.send(client.pack_heartbeat())
        client.spend(0.3)
    got = listener.receive(0.0)
    report.add("link.listening-port", "stays" if moved and not got else "comes back")
    report.skip(FACTS[:1], "the first sender was another port")
    if moved:
        listener.close()
    else:
        client.port = listener
        stranger.close()


PHASE = Phase("first and second sender", FACTS, run, turns_motors=False)
