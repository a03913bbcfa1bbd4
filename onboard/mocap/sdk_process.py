"""The process that reads a motion capture and writes its frames to a pipe.

It uses the package ``motioncapture``, which must not run in an agent's process. While the package
connects, it holds Python's global lock, and it does so forever if the system does not answer. If
the system sends unknown data, the package may end the process.

:mod:`onboard.mocap.sdk_source` runs this file as ``python -m onboard.mocap.sdk_process SETTINGS``.
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

from onboard.exit_status import EXIT_OK, EXIT_WRONG_INPUT
from onboard.tuples import Wxyz, Xyz

_PR_SET_PDEATHSIG = 1  # option of prctl(2): signal for this process when its parent ends
_NUMERIC_ONLY = {"optitrack"}  # types for which the package needs a numeric address, not a name


class Settings(msgspec.Struct, frozen=True):
    """Settings for the package."""

    type: str  # type of the motion-capture system, for instance "vicon"
    options: dict[str, str]  # hostname, and options of this type


class RawFrame(msgspec.Struct, frozen=True, array_like=True):
    """One frame as it arrived, or a problem instead."""

    arrived_ns: int  # on this host's monotonic clock
    bodies: dict[str, tuple[Xyz, Wxyz]]  # body -> position and attitude in the mocap's own frame
    problem: str = ""  # sentence that says why no frames arrive


_encoder = msgspec.msgpack.Encoder()


def write_frame(pipe: int, frame: RawFrame) -> None:
    """Write one frame to the pipe: its length in four bytes, and its data."""
    data = _encoder.encode(frame)
    os.write(pipe, len(data).to_bytes(4, "little") + data)


def main(argv: list[str]) -> int:
    """Read frames until the parent process has ended; return the exit status."""
    # The package holds Python's lock while it connects, so only the kernel can end this process
    # when its parent ends.
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    # The agent also gets these signals, and still needs the poses for landing.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)

    # The pipe is this process's stdout, but the package prints on stdout. So the pipe gets another
    # descriptor, and stdout is redirected to stderr.
    pipe = os.dup(1)
    os.dup2(2, 1)

    settings = msgspec.json.decode(argv[0], type=Settings)
    try:
        _read(settings, pipe)
    except BrokenPipeError:
        return EXIT_OK
    except ModuleNotFoundError:
        write_frame(pipe, RawFrame(arrived_ns=0, bodies={}, problem=NOT_INSTALLED))
    except (RuntimeError, OSError, ValueError) as error:
        problem = _sentence(settings, error)
        write_frame(pipe, RawFrame(arrived_ns=0, bodies={}, problem=problem))
    return EXIT_WRONG_INPUT


NOT_INSTALLED = (
    "The package 'motioncapture' is not installed: pip install 'motioncapture>=1.1,<2'. If there "
    "is no wheel for this computer, run 'covey mocap' on another one and set mocap.direct = false."
)


def _read(settings: Settings, pipe: int) -> None:
    """Connect with the system, and write its frames until the pipe is closed."""
    # import numpy now, because the package would otherwise import it while the first frames wait
    importlib.import_module("numpy")
    package: Any = importlib.import_module("motioncapture")

    options = dict(settings.options)
    if settings.type in _NUMERIC_ONLY and "hostname" in options:
        options["hostname"] = socket.gethostbyname(options["hostname"])
    system = package.connect(settings.type, options)

    while True:
        system.waitForNextFrame()
        arrived_ns = time.monotonic_ns()
        bodies: dict[str, tuple[Xyz, Wxyz]] = {}
        for name, body in system.rigidBodies.items():
            x, y, z = body.position.tolist()
            q = body.rotation
            bodies[name] = ((x, y, z), (q.w, q.x, q.y, q.z))
        write_frame(pipe, RawFrame(arrived_ns, bodies))


def _sentence(settings: Settings, error: Exception) -> str:
    """Return the sentence that says why the system cannot be read, and what to do."""
    host = settings.options.get("hostname", "this computer")
    if "Unknown motion capture type" in str(error):
        return (
            f"The installed package 'motioncapture' cannot read {settings.type}: it was built "
            "without that system. Its wheel on PyPI reads optitrack, vicon, qualisys, vrpn and "
            "mock; build it from source for others."
        )
    return (
        f"{settings.type} at {host} cannot be read: {error}. Check mocap.hostname, that the system "
        "streams, and the firewall of its computer."
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
