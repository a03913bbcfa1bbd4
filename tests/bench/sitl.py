"""Cost of the emulator: `make bench-sitl` runs it beside a listening client and reads the
processor's clock.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import json
import selectors
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from sitl.emulator.emulator import Emulator, VehicleSpec
from sitl.mavlink.endpoints import Address, Socket, read_all
from sitl.mavlink.link import Link
from sitl.mavlink.streams import GCS_RATES_HZ, ONBOARD_RATES_HZ
from sitl.physics.vehicle import STEP_S, VehicleProfile

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_WRONG_INPUT = 2
# What is asked of the emulator, in percent of a core per vehicle.
LIMITS_PCT = {3: 4.0, 50: 1.8}
_SPACING_M = 3.0
_WARM_UP_S = 1.5
_MAX_STEPS_AT_ONCE = 70


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of one fleet, in percent of one core per vehicle.

    Attributes:
        vehicles: how many.
        flying_pct: all of it: physics, estimates, autopilots, both links at default rates, sockets,
            in real time.
        physics_pct: the emulator alone, without links.
        datagrams_per_s: per vehicle, as received by the client.
        real_time: simulated over wall time.
    """

    vehicles: int
    flying_pct: float
    physics_pct: float
    datagrams_per_s: float
    real_time: float


class Listener:
    """A client in a process of its own that counts what arrives: neither its time nor its lock is
    the emulator's.
    """

    def __init__(self, count: int) -> None:
        command = [sys.executable, "-m", "tests.bench.sitl", "--listen", str(count)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        ports = self._process.stdout.readline().split()
        self.addresses: list[Address] = [("127.0.0.1", int(port)) for port in ports]

    def close(self) -> int:
        """Stop listening; how many datagrams came."""
        received, _ = self._process.communicate(timeout=10.0)
        return int(received)


def listen(count: int) -> None:
    """The listening process: tells its ports, counts until its standard input ends, tells the
    count.
    """
    received = 0
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    with selectors.DefaultSelector() as selector:
        for sock in sockets:
            sock.bind(("127.0.0.1", 0))
            sock.setblocking(False)
            selector.register(sock, selectors.EVENT_READ, sock)
        selector.register(sys.stdin, selectors.EVENT_READ, None)
        print(*(sock.getsockname()[1] for sock in sockets), flush=True)
        while True:
            for key, _ in selector.select():
                if key.data is None:
                    print(received, flush=True)
                    return
                received += _drain(key.data)
            time.sleep(0.02)


def _drain(sock: socket.socket) -> int:
    count = 0
    while True:
        try:
            sock.recv(512)
        except BlockingIOError:
            return count
        count += 1


def fleet_of(count: int) -> Emulator:
    """Vehicles in a row, far enough apart."""
    specs = [
        VehicleSpec(f"v{i}", i % 250 + 1, VehicleProfile(), (_SPACING_M * i, 0.0, 0.0))
        for i in range(count)
    ]
    return Emulator(specs, seed=0)


def physics_pct(count: int, duration_s: float) -> float:
    """Cost of the emulator without links, as fast as it goes."""
    emulator = fleet_of(count)
    for _ in range(round(1.0 / STEP_S)):
        emulator.step()
    steps = round(duration_s / STEP_S)
    start_s = time.process_time()
    for _ in range(steps):
        emulator.step()
    return 100.0 * (time.process_time() - start_s) / (steps * STEP_S) / count


async def _fly(
    emulator: Emulator, addresses: Sequence[Address], duration_s: float
) -> tuple[float, float, float]:
    """CPU seconds of this thread, wall seconds and simulated seconds of a real-time run."""
    loop = asyncio.get_running_loop()
    sockets: list[Socket] = []
    ready = selectors.DefaultSelector()
    for index, rates_hz in itertools.product(
        range(len(addresses)), (ONBOARD_RATES_HZ, GCS_RATES_HZ)
    ):
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.bind(("127.0.0.1", 0))
        sock.setblocking(False)
        opened = Socket(sock, Link(emulator, index, rates_hz), None)
        opened.open(ready)
        sockets.append(opened)
    for _ in range(round(_WARM_UP_S / STEP_S)):
        emulator.step()
        for each in sockets:
            each.endpoint.poll()
    for index, each in enumerate(sockets):
        each.endpoint.peer = addresses[index // 2]
    first_step = emulator.world.vehicles.steps
    start_s = loop.time()
    cpu_s = time.thread_time()
    while (now_s := loop.time() - start_s) < duration_s:
        due = int(now_s / STEP_S) - (emulator.world.vehicles.steps - first_step)
        for _ in range(min(due, _MAX_STEPS_AT_ONCE)):
            read_all(ready)
            emulator.step()
            for each in sockets:
                each.endpoint.poll()
        done_s = (emulator.world.vehicles.steps - first_step + 1) * STEP_S
        await asyncio.sleep(max(0.0, start_s + done_s - loop.time()))
    spent_s = time.thread_time() - cpu_s
    wall_s = loop.time() - start_s
    for each in sockets:
        each.close(ready)
    return spent_s, wall_s, (emulator.world.vehicles.steps - first_step) * STEP_S


def measure(count: int, duration_s: float) -> Cost:
    """Cost of a fleet of `count` vehicles, over `duration_s` of real time."""
    listener = Listener(count)
    try:
        cpu_s, wall_s, simulated_s = asyncio.run(
            _fly(fleet_of(count), listener.addresses, duration_s)
        )
    finally:
        heard = listener.close()
    return Cost(
        vehicles=count,
        flying_pct=100.0 * cpu_s / simulated_s / count,
        physics_pct=physics_pct(count, min(duration_s, 4.0)),
        datagrams_per_s=heard / simulated_s / count,
        real_time=simulated_s / wall_s,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """The command `make bench-sitl`."""
    parser = argparse.ArgumentParser(
        prog="make bench-sitl",
        description="CPU of the emulated PX4s at default rates, in real time, beside a client.",
    )
    parser.add_argument("--vehicles", default="3,10,50", help="fleet sizes (default 3,10,50)")
    parser.add_argument("--seconds", type=float, default=8.0, help="real time per size (default 8)")
    parser.add_argument("--json", action="store_true", help="figures as JSON on stdout")
    parser.add_argument("--listen", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.listen is not None:
        listen(options.listen)
        return EXIT_OK
    try:
        sizes = [int(word) for word in options.vehicles.split(",")]
    except ValueError:
        sizes = []
    if not sizes or min(sizes) < 1 or max(sizes) > 1000 or not 0.5 <= options.seconds <= 3600.0:
        print(
            "bench sitl: give sizes as 3,10,50 (1 to 1000) and 0.5 to 3600 seconds.",
            file=sys.stderr,
        )
        return EXIT_WRONG_INPUT
    costs = [measure(size, options.seconds) for size in sizes]
    if options.json:
        print(json.dumps([asdict(cost) for cost in costs]))
    else:
        print("vehicles  all %  physics %  datagrams/s  real time   (% of a core per vehicle)")
        for cost in costs:
            limit = LIMITS_PCT.get(cost.vehicles)
            expected = f"   at most {limit} %" if limit else ""
            print(
                f"{cost.vehicles:8d}  {cost.flying_pct:5.2f}  {cost.physics_pct:9.2f}  "
                f"{cost.datagrams_per_s:11.0f}"
                f"  {cost.real_time:9.3f}{expected}"
            )
    within = all(cost.flying_pct <= LIMITS_PCT.get(cost.vehicles, 100.0) for cost in costs)
    return EXIT_OK if within else EXIT_FAILED


if __name__ == "__main__":
    sys.exit(main())
