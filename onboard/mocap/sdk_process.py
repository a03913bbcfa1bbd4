"""The process that reads a motion capture with the package ``motioncapture`` and writes its frames to a pipe.

A process of its own, because the package may stop the whole interpreter: it connects without letting go of Python's
lock, for ever where nobody answers, and it may end the process when the system sends what it does not understand.
Neither may happen to an agent. Run as ``python -m onboard.mocap.sdk_process SETTINGS`` by
:mod:`onboard.mocap.sdk_source`.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import signal
import socket
import sys
import time
from typing import Any

import msgspec

from onboard.bus.schema import Vec3, Vec4
from onboard.exit_status import EXIT_OK, EXIT_WRONG_INPUT

_PR_SET_PDEATHSIG = 1
_NUMERIC_ONLY = {"optitrack"}  # this part of the package understands addresses, not names


class Settings(msgspec.Struct, frozen=True):
    """What the package is told."""

    type: str
    options: dict[str, str]


class RawFrame(msgspec.Struct, frozen=True, array_like=True):
    """One frame as it came: its arrival on this host's monotonic clock, bodies in the mocap's own frame.

    A frame of no bodies with a ``problem`` says why there will be none.
    """

    arrived_ns: int
    bodies: dict[str, tuple[Vec3, Vec4]]
    problem: str = ""


_encoder = msgspec.msgpack.Encoder()


def write_frame(pipe: int, frame: RawFrame) -> None:
    """One frame with its length in front; less than a pipe takes at once, so it comes whole or not at all."""
    data = _encoder.encode(frame)
    os.write(pipe, len(data).to_bytes(4, "little") + data)


def main(argv: list[str]) -> int:
    """Read until the parent is gone."""
    # The package holds Python's lock while it connects, so that only the kernel can end it with its parent.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    for number in (signal.SIGINT, signal.SIGTERM):  # the agent lands first, by these poses
        signal.signal(number, signal.SIG_IGN)
    pipe = os.dup(1)
    os.dup2(2, 1)  # the package prints on stdout, which is the pipe
    settings = msgspec.json.decode(argv[0], type=Settings)
    try:
        _read(settings, pipe)
    except BrokenPipeError:
        return EXIT_OK
    except ModuleNotFoundError:
        write_frame(pipe, RawFrame(0, {}, NOT_INSTALLED))
    except (RuntimeError, OSError, ValueError) as error:
        write_frame(pipe, RawFrame(0, {}, _sentence(settings, error)))
    return EXIT_WRONG_INPUT


NOT_INSTALLED = (
    "The package 'motioncapture' is not installed: pip install 'covey[mocap]'. Where there is no wheel of it for this "
    "computer, run 'covey mocap' on another one and set mocap.direct = false."
)


def _read(settings: Settings, pipe: int) -> None:
    importlib.import_module("numpy")  # else the first body's position does it, while frames wait
    package: Any = importlib.import_module("motioncapture")
    options = dict(settings.options)
    if settings.type in _NUMERIC_ONLY and "hostname" in options:
        options["hostname"] = socket.gethostbyname(options["hostname"])
    system = package.connect(settings.type, options)
    while True:
        system.waitForNextFrame()
        arrived_ns = time.monotonic_ns()
        bodies: dict[str, tuple[Vec3, Vec4]] = {}
        for name, body in system.rigidBodies.items():
            x, y, z = body.position.tolist()
            q = body.rotation
            bodies[name] = (x, y, z), (q.w, q.x, q.y, q.z)
        write_frame(pipe, RawFrame(arrived_ns, bodies))


def _sentence(settings: Settings, error: Exception) -> str:
    where = settings.options.get("hostname", "this computer")
    if "Unknown motion capture type" in str(error):
        return (
            f"The installed package 'motioncapture' cannot read {settings.type}: it was built without. Its wheel on "
            "PyPI reads optitrack, vicon, qualisys, vrpn and mock; build it from source for others."
        )
    return (
        f"{settings.type} at {where} cannot be read: {error}. Check mocap.hostname, that the system streams, and the "
        "firewall of its computer."
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
