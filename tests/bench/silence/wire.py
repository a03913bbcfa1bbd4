"""An independent listener between agents and PX4s: forwards every datagram and writes down when
setpoints pass.

A process of its own with plain sockets, and the times are the kernel's own of each arrival: neither
the agents' code nor anybody's scheduling can move a stamp. ``python -m tests.bench.silence.wire LOG
NAME:FRONT:AUTOPILOT:AGENT ...``
"""

from __future__ import annotations

import select
import socket
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

_SO_TIMESTAMPNS = 35
_STX_2 = 0xFD
HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
# everything that moves a PX4 while it flies in OFFBOARD, or instead of it
SETPOINTS = {
    mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    mavlink.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET,
    mavlink.MAVLINK_MSG_ID_MANUAL_CONTROL,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE,
}


@dataclass(frozen=True, slots=True)
class Passed:
    """A setpoint or a heartbeat that passed: when [ns of CLOCK_MONOTONIC], of which vehicle, what a
    heartbeat said.
    """

    stamp_ns: int
    vehicle: str
    is_setpoint: bool
    is_armed: bool = False
    custom_mode: int = 0

    @property
    def line(self) -> str:
        """For the log."""
        flags = f"{int(self.is_setpoint)} {int(self.is_armed)}"
        return f"{self.stamp_ns} {self.vehicle} {flags} {self.custom_mode}\n"


def read(log: Path) -> list[Passed]:
    """Return the datagrams so far, in the order of their stamps."""
    found = []
    for line in log.read_text(encoding="ascii").splitlines(keepends=True):
        if line.endswith("\n"):
            stamp, vehicle, is_setpoint, is_armed, mode = line.split()
            found.append(
                Passed(
                    stamp_ns=int(stamp),
                    vehicle=vehicle,
                    is_setpoint=is_setpoint == "1",
                    is_armed=is_armed == "1",
                    custom_mode=int(mode),
                )
            )
    return sorted(found, key=lambda one: one.stamp_ns)


def frames(datagram: bytes) -> Iterator[tuple[int, bytes]]:
    """Message id and payload of each MAVLink 2 frame of a datagram."""
    at = 0
    while at + 12 <= len(datagram) and datagram[at] == _STX_2:
        length = datagram[at + 1]
        flags = datagram[at + 2]
        yield (
            int.from_bytes(datagram[at + 7 : at + 10], "little"),
            datagram[at + 10 : at + 10 + length],
        )
        at += 12 + length + (13 if flags & 1 else 0)


def _bound(port: int) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    sock.bind(("127.0.0.1", port))
    return sock


def _receive(sock: socket.socket) -> tuple[bytes, int]:
    """One datagram and when the kernel took it, on the monotonic clock."""
    data, extra, _, _ = sock.recvmsg(65536, 64)
    offset_ns = time.monotonic_ns() - time.time_ns()
    for _, kind, value in extra:
        if kind == _SO_TIMESTAMPNS:
            seconds, nanoseconds = struct.unpack("qq", value[:16])
            return data, seconds * 10**9 + nanoseconds + offset_ns
    return data, time.monotonic_ns()


def main(argv: list[str]) -> None:
    """Forward until killed."""
    log = Path(argv[0]).open("w", encoding="ascii")  # noqa: SIM115 - for the life of the process
    ways: dict[socket.socket, tuple[str, socket.socket, tuple[str, int], bool]] = {}
    for word in argv[1:]:
        name, front, autopilot, agent = word.split(":")
        here = _bound(int(front))
        there = _bound(0)
        ways[here] = name, there, ("127.0.0.1", int(agent)), False
        ways[there] = name, here, ("127.0.0.1", int(autopilot)), True
    print("ready", flush=True)
    while True:
        for ready in select.select(list(ways), [], [], 0.2)[0]:
            name, out, address, is_from_agent = ways[ready]
            data, stamp_ns = _receive(ready)
            for message_id, payload in frames(data):
                if is_from_agent and message_id in SETPOINTS:
                    log.write(Passed(stamp_ns, name, True).line)
                elif not is_from_agent and message_id == HEARTBEAT:
                    mode, *_, base_mode, _ = struct.unpack("<IBBBB", payload.ljust(9, b"\0")[:8])
                    log.write(
                        Passed(
                            stamp_ns=stamp_ns,
                            vehicle=name,
                            is_setpoint=False,
                            is_armed=bool(base_mode & 128),
                            custom_mode=mode,
                        ).line
                    )
            try:
                out.sendto(data, address)
            except OSError:
                continue  # nobody listens there now
        log.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
