"""A MAVLink link with the faults of its two directions, and with restarts of the autopilot."""

from __future__ import annotations

from collections.abc import Mapping

from sitl.emulator.emulator import Emulator
from sitl.mavlink.link import Link

_LINK_IDS = ("ground", "companion", "simulator")  # names in the order of PX4's numbers


class LossyLink:
    """A link of one vehicle, with its faults and restarts.

    Args:
        emulator: emulator with the vehicle.
        index: index of the vehicle.
        rates_hz: default rates of the messages, see :class:`Link`.
        name: name of the link: "companion" or "ground", as in faults, or "simulator".
    """

    def __init__(
        self, emulator: Emulator, index: int, rates_hz: Mapping[int, float], name: str
    ) -> None:
        self._emulator = emulator
        self._index = index
        self._rates_hz = rates_hz
        self._link_id = _LINK_IDS.index(name)

        wires = emulator.disturbances.wires[index]
        self._in = wires[name, "in"]
        self._out = wires[name, "out"]

        self.link = Link(emulator, index, rates_hz, self._link_id)
        self.boot = emulator.disturbances.boots[index]

    def receive(self, datagram: bytes) -> list[bytes]:
        """Receive one datagram; return the datagrams that leave now."""
        if self._in.is_clear and self._out.is_clear:
            self._follow_restart()
            return self.link.receive(datagram)

        now_s = self._emulator.time_s
        self._in.push(now_s, datagram)
        return self._leave(now_s, self._arrived(now_s))

    def poll(self) -> list[bytes]:
        """Return the datagrams that leave at the emulator's present time."""
        self._follow_restart()
        now_s = self._emulator.time_s

        streamed: list[bytes] = []
        is_hung = self._emulator.disturbances.is_hung[self._index]
        if not is_hung:
            streamed = self.link.poll()

        if self._in.is_clear and self._out.is_clear:
            return streamed
        return self._leave(now_s, self._arrived(now_s) + streamed)

    def _arrived(self, now_s: float) -> list[bytes]:
        """Pass the datagrams that have arrived to the link; return its answers."""
        self._follow_restart()
        answers: list[bytes] = []
        for datagram in self._in.pop(now_s):
            answers.extend(self.link.receive(datagram))
        return answers

    def _leave(self, now_s: float, datagrams: list[bytes]) -> list[bytes]:
        """Send datagrams through the outgoing channel; return those that leave it now."""
        if self._out.is_clear:
            return datagrams

        for datagram in datagrams:
            self._out.push(now_s, datagram)
        return self._out.pop(now_s)

    def _follow_restart(self) -> None:
        boot = self._emulator.disturbances.boots[self._index]
        if boot != self.boot:
            # A restart resets rates, sequence numbers and requests.
            self.boot = boot
            self.link = Link(self._emulator, self._index, self._rates_hz, self._link_id)
