"""The emulator's own links and endpoints under the conformance suite in simulated time: no sockets, no waiting."""

from __future__ import annotations

from collections import deque
from typing import Any

from sitl.emulator import Emulator, VehicleSpec
from sitl.link import Link
from sitl.server import _Endpoint
from sitl.streams import GCS_RATES_HZ, ONBOARD_RATES_HZ
from sitl.vehicle import VehicleProfile

Address = tuple[str, int]
LISTENER: Address = ("127.0.0.1", 14540)
GROUND: Address = ("127.0.0.1", 14550)


class Wires:
    """One emulated vehicle with its companion link and its ground link; time passes when somebody waits."""

    def __init__(self, seed: int = 1, profile: VehicleProfile | None = None) -> None:
        spec = VehicleSpec("v0", 1, profile or VehicleProfile(), (0.0, 0.0, 0.0))
        self.emulator = Emulator([spec], seed=seed)
        self.inboxes: dict[Address, deque[bytes]] = {}
        self.onboard = self._endpoint(ONBOARD_RATES_HZ, LISTENER)
        self.ground = self._endpoint(GCS_RATES_HZ, GROUND)
        self._next_port = 40000

    def _endpoint(self, rates_hz: dict[int, float], peer: Address) -> _Endpoint:
        endpoint = _Endpoint(Link(self.emulator, 0, rates_hz), peer)
        endpoint.attach(self)  # type: ignore[arg-type]
        return endpoint

    def sendto(self, datagram: bytes, address: Address) -> None:
        """As asyncio's transport."""
        if address in self.inboxes:
            self.inboxes[address].append(datagram)

    def port(self, endpoint: Any = None, address: Address | None = None) -> VirtualPort:
        """A client's way to one of the links; from a new address unless one is given."""
        if address is None:
            self._next_port += 1
            address = ("127.0.0.1", self._next_port)
        self.inboxes[address] = deque()
        return VirtualPort(self, endpoint or self.onboard, address)

    def companion(self) -> VirtualPort:
        """The way of who listens where the vehicle streams unasked."""
        return self.port(self.onboard, LISTENER)

    def ground_station(self) -> VirtualPort:
        """Likewise on the ground's link."""
        return self.port(self.ground, GROUND)

    def step(self) -> None:
        """One step of the emulator, and what it sends."""
        self.emulator.step()
        self.onboard.poll()
        self.ground.poll()


class VirtualPort:
    """The suite's port into `Wires`."""

    def __init__(self, wires: Wires, endpoint: _Endpoint, address: Address) -> None:
        self._wires, self._endpoint, self._address = wires, endpoint, address

    def now_s(self) -> float:
        return self._wires.emulator.time_s

    def receive(self, timeout_s: float) -> list[bytes]:
        inbox = self._wires.inboxes[self._address]
        end_s = self.now_s() + timeout_s
        while not inbox and self.now_s() < end_s - 1e-9:
            self._wires.step()
        datagrams = list(inbox)
        inbox.clear()
        return datagrams

    def send(self, datagram: bytes) -> None:
        self._endpoint.datagram_received(datagram, self._address)

    def stranger(self) -> VirtualPort:
        return self._wires.port(self._endpoint)

    def close(self) -> None:
        self._wires.inboxes.pop(self._address, None)
