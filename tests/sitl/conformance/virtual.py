"""The emulator's own links and endpoints under the conformance suite in simulated time: no sockets,
no waiting.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence

from sitl.emulator.emulator import Emulator, VehicleSpec
from sitl.mavlink.endpoints import Endpoint
from sitl.mavlink.link import Link
from sitl.mavlink.streams import GCS_RATES_HZ, ONBOARD_RATES_HZ, SIMULATOR_RATES_HZ
from sitl.physics.vehicle import VehicleProfile
from sitl.px4.versions import VERSIONS

Address = tuple[str, int]
Change = Callable[[bytes], Sequence[bytes]]
LISTENER: Address = ("127.0.0.1", 14540)
GROUND: Address = ("127.0.0.1", 14550)
VIEWER: Address = ("127.0.0.1", 19410)


def _unchanged(frame: bytes) -> Sequence[bytes]:
    return (frame,)


class Wires:
    """One emulated vehicle with its companion link and its ground link; time passes when somebody
    waits.

    Attributes:
        incoming, outgoing: what becomes of each frame that a client or the emulator sends; nothing
            is done unless a mutant says otherwise.
        follows_newest: stream to whoever spoke last, as PX4 does not.
    """

    def __init__(
        self, seed: int = 1, profile: VehicleProfile | None = None, px4: str = "1.16"
    ) -> None:
        spec = VehicleSpec(
            name="v0",
            system_id=1,
            profile=profile or VehicleProfile(),
            start_enu_m=(0.0, 0.0, 0.0),
            px4=VERSIONS[px4],
        )
        self.emulator = Emulator([spec], seed=seed)
        self.inboxes: dict[Address, deque[bytes]] = {}
        self.incoming: Change = _unchanged
        self.outgoing: Change = _unchanged
        self.follows_newest = False
        self.newest = LISTENER
        self.onboard = _Socket(self, ONBOARD_RATES_HZ, LISTENER)
        self.ground = _Socket(self, GCS_RATES_HZ, GROUND)
        self.simulator = _Socket(self, SIMULATOR_RATES_HZ, VIEWER)
        self._next_port = 40000

    def port(self, socket: _Socket | None = None, address: Address | None = None) -> VirtualPort:
        """A client's way to one of the links; from a new address unless one is given."""
        if address is None:
            self._next_port += 1
            address = ("127.0.0.1", self._next_port)
        self.inboxes[address] = deque()
        return VirtualPort(self, socket or self.onboard, address)

    def companion(self) -> VirtualPort:
        """The way of who listens where the vehicle streams unasked."""
        return self.port(self.onboard, LISTENER)

    def ground_station(self) -> VirtualPort:
        """Likewise on the ground's link."""
        return self.port(self.ground, GROUND)

    def viewer(self) -> VirtualPort:
        """Likewise on the simulator's link."""
        return self.port(self.simulator, VIEWER)

    def step(self) -> None:
        """One step of the emulator, and what it sends."""
        self.emulator.step()
        self.onboard.endpoint.poll()
        self.ground.endpoint.poll()
        if VIEWER in self.inboxes:
            self.simulator.endpoint.poll()


class _Socket:
    """One endpoint of the emulator and what reaches it."""

    def __init__(self, wires: Wires, rates_hz: dict[int, float], peer: Address) -> None:
        self._wires = wires
        self.endpoint = Endpoint(Link(wires.emulator, 0, rates_hz), peer, self._send)

    def deliver(self, datagram: bytes, sender: Address) -> None:
        """A client's datagram arrives."""
        self._wires.newest = sender
        for each in self._wires.incoming(datagram):
            self.endpoint.receive(each, sender)

    def _send(self, datagram: bytes, address: Address) -> None:
        if self._wires.follows_newest and address not in (GROUND, VIEWER):
            address = self._wires.newest
        if address in self._wires.inboxes:
            self._wires.inboxes[address].extend(self._wires.outgoing(datagram))


class VirtualPort:
    """The suite's port into `Wires`."""

    def __init__(self, wires: Wires, socket: _Socket, address: Address) -> None:
        self._wires = wires
        self._socket = socket
        self._address = address

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
        self._socket.deliver(datagram, self._address)

    def another_sender(self) -> VirtualPort:
        return self._wires.port(self._socket)

    def close(self) -> None:
        self._wires.inboxes.pop(self._address, None)
