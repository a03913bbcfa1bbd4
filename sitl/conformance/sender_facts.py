"""Facts of senders: the first sender stays the peer, and a key requires signatures."""

from __future__ import annotations

import time

from sitl.conformance.endpoint import is_signed
from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import grounded
from sitl.conformance.vehicle_client import REQUEST, Signature, VehicleClient

FACTS = facts("senders", "facts")
_SECOND_SENDER_FACT, *_FROM_ELSEWHERE_FACTS = FACTS
SIGNING_FACTS = facts("signing", "facts")
_KEY = bytes(range(1, 33))
_OTHER_KEY = bytes(range(2, 34))
LINK_ID = 12
_OTHER_LINK_ID = 13
_BEGIN_OF_2015_S = 1_420_070_400  # Unix time
_STEPS_PER_S = 100_000  # resolution of the timestamps
_HEARTBEAT = 0.0  # message id, sent as a command parameter


def run(client: VehicleClient, report: FactReport) -> None:
    """Send the first datagrams to the vehicle from one port, then datagrams from another."""
    if client.moves_first_sender:
        _from_elsewhere(client, report)
        return

    report.skip(
        _FROM_ELSEWHERE_FACTS,
        "it leaves the vehicle locked to a port that is gone: see --from-elsewhere",
    )
    client.greet(as_ground_station=False)
    client.wait(0.5)

    second = client.port.another_sender()
    try:
        for _ in range(3):
            second.send(client.pack_heartbeat())
            client.wait(0.3)
        streamed_before = second.receive(0.0)
        client.wait(0.3)
        has_moved = bool(streamed_before) or bool(second.receive(0.0))
        if has_moved:
            report.add("link.second-sender", "moves")
        else:
            report.add("link.second-sender", "stays")
    finally:
        second.close()


def _from_elsewhere(client: VehicleClient, report: FactReport) -> None:
    """Send first from another port, then from the port that listens; report where PX4 sends."""
    listener = client.port
    first = client.port.another_sender()
    client.port = first
    client.greet(as_ground_station=False)
    client.wait(0.6)
    listener.receive(0.0)  # drop what has arrived so far
    client.wait(0.4)
    has_moved = not listener.receive(0.0)
    if has_moved:
        report.add("link.first-sender", "moves there")
    else:
        report.add("link.first-sender", "stays")

    for _ in range(3):
        listener.send(client.pack_heartbeat())
        client.wait(0.3)
    is_heard_again = bool(listener.receive(0.0))
    if has_moved and not is_heard_again:
        report.add("link.listening-port", "stays")
    else:
        report.add("link.listening-port", "comes back")
    report.skip([_SECOND_SENDER_FACT], "the first sender was another port")

    if has_moved:
        listener.close()
    else:
        client.port = listener
        first.close()


def signing_time() -> int:
    """Return the present timestamp [10 us since 2015]."""
    return int((time.time() - _BEGIN_OF_2015_S) * _STEPS_PER_S)


def run_signing(client: VehicleClient, report: FactReport) -> None:
    """Set a key, send with it and without it, and remove it."""
    if client.signature is not None:
        report.skip(SIGNING_FACTS, "it has a key already")
        return
    grounded(client)

    client.signature = Signature(_KEY, LINK_ID, signing_time())
    report.add("signing.before", client.command(REQUEST, _HEARTBEAT))

    client.signature = None
    _set_key(client, _KEY, signing_time())
    report.add("signing.messages", _messages(client))
    report.add("signing.unsigned", client.command(REQUEST, _HEARTBEAT))

    now = signing_time()
    client.signature = Signature(_KEY, LINK_ID, now)
    report.add("signing.signed", client.command(REQUEST, _HEARTBEAT))

    client.signature = Signature(_KEY, LINK_ID, now - 10 * _STEPS_PER_S)
    report.add("signing.older", client.command(REQUEST, _HEARTBEAT))

    client.signature = Signature(_KEY, _OTHER_LINK_ID, now - 90 * _STEPS_PER_S)
    report.add("signing.other-sender", client.command(REQUEST, _HEARTBEAT))

    client.signature = Signature(_OTHER_KEY, LINK_ID, now + _STEPS_PER_S)
    report.add("signing.other-key", client.command(REQUEST, _HEARTBEAT))

    _set_key(client, _OTHER_KEY, signing_time())
    client.signature = Signature(_KEY, LINK_ID, now + 2 * _STEPS_PER_S)
    report.add("signing.kept", client.command(REQUEST, _HEARTBEAT))

    _set_key(client, bytes(32), 0)
    client.signature = None
    report.add("signing.removed", _messages(client))


def _set_key(client: VehicleClient, key: bytes, timestamp: int) -> None:
    """Set the vehicle's key, by two messages; a key of zeros with timestamp 0 removes it."""
    for _ in range(2):
        client.send(
            "SETUP_SIGNING",
            target_system=99,  # PX4 accepts this message with any address
            target_component=1,
            secret_key=key,
            initial_timestamp=timestamp,
        )
        client.wait(0.2)


def _messages(client: VehicleClient) -> str:
    """Return whether the vehicle's messages of the next half second are signed, as a word."""
    since_s = client.now_s
    client.wait(0.5)
    packets = [packet for packet in client.received.of("ATTITUDE", since_s) if not packet.is_v1]
    kinds = {is_signed(packet.frame) for packet in packets}
    if kinds == {True}:
        return "signed"
    if kinds == {False}:
        return "unsigned"
    return "both"


FACT_GROUP = FactGroup("first and second sender", FACTS, run, turns_motors=False)
SIGNING_GROUP = FactGroup("signing", SIGNING_FACTS, run_signing)
