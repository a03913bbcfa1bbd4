"""Mocap poses from a motion-capture system, read by another process: see
:mod:`onboard.mocap.sdk_process`.

A thread starts the reading process, converts its frames to poses in the fleet's frame, and starts
it again when it has ended or sent nothing for a while. A body that is missing in the frames is
passed on as not tracked, so that a lost body differs from a dead source.
"""

from __future__ import annotations

import logging
import os
import select
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field

import msgspec

from onboard.bus.schema import MocapPose
from onboard.config.mocap import MocapConfig
from onboard.mocap.frame import Frame
from onboard.mocap.sdk_process import RawFrame, Settings
from onboard.mocap.source import OnMalformed, OnPose

_LOST_NS = 100_000_000
_FORGOTTEN_NS = 10_000_000_000
QUIET_S = 2.0  # without frames, before the reading process is started again
CONNECT_S = 5.0  # the same before the first frame
_AGAIN_S = 1.0
_LARGEST_FRAME = 1 << 20

log = logging.getLogger("covey.mocap")
_decoder = msgspec.msgpack.Decoder(RawFrame)


@dataclass(slots=True)
class PoseConverter:
    """Converts frames to poses: frame, stamps, sequence, lost bodies. No I/O."""

    mocap: MocapConfig
    boot_id: int
    source: str = ""  # node whose clock stamps the poses
    sequence: int = 0
    _next_ns: int = 0
    _frame: Frame = field(init=False)
    _latency_ns: int = field(init=False)
    _period_ns: int = field(init=False)
    _last: dict[str, MocapPose] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._frame, self._latency_ns = Frame.of(self.mocap), int(self.mocap.latency_s * 1e9)
        self._period_ns = int(1e9 / self.mocap.max_rate_hz)

    def poses(self, raw: RawFrame) -> list[MocapPose]:
        """Return the poses of one frame; a body lost for 0.1 s is returned as not tracked, for 10
        s.
        """
        # beyond the configured rate; a bit early is allowed
        if raw.arrived_ns < self._next_ns - self._period_ns // 10:
            return []
        self._next_ns = max(self._next_ns, raw.arrived_ns - self._period_ns) + self._period_ns
        self.sequence += 1
        stamp_ns = raw.arrived_ns - self._latency_ns
        poses = []
        for body, (position, quaternion) in raw.bodies.items():
            pose = MocapPose(
                body=body,
                boot_id=self.boot_id,
                sequence=self.sequence,
                stamp_ns=stamp_ns,
                is_tracked=True,
                position_enu_m=self._frame.position_enu_m(position),
                quaternion_enu_flu_wxyz=self._frame.quaternion_enu_flu_wxyz(quaternion),
                source=self.source,
            )
            self._last[body] = pose
            poses.append(pose)
        for body in [body for body in self._last if body not in raw.bodies]:
            last = self._last[body]
            if stamp_ns - last.stamp_ns > _FORGOTTEN_NS:
                del self._last[body]
            elif stamp_ns - last.stamp_ns > _LOST_NS:
                poses.append(
                    msgspec.structs.replace(
                        last, sequence=self.sequence, stamp_ns=stamp_ns, is_tracked=False
                    )
                )
        return poses


class SdkMocap:
    """A system that the package ``motioncapture`` reads; callbacks come on a thread of this object.

    Args:
        mocap: the fleet file's table, with ``source = "motioncapture"``.
        body: name of the body; ``*`` for all.
        on_pose: called with each pose and its arrival [ns].
        on_malformed: called for bytes that are no frame.
        node: node that publishes the poses on the bus; empty if they stay in this process.
        default_options: for the package, where the fleet file has none.
    """

    def __init__(
        self,
        mocap: MocapConfig,
        body: str,
        on_pose: OnPose,
        on_malformed: OnMalformed,
        *,
        node: str = "",
        default_options: dict[str, str] | None = None,
    ) -> None:
        self._body, self._on_pose, self._on_malformed = body, on_pose, on_malformed
        self._converter = PoseConverter(
            mocap, boot_id=int.from_bytes(os.urandom(4), "little") & 0x7FFFFFFF, source=node
        )
        options = {key: _text(value) for key, value in mocap.options.items()}
        host = {"hostname": mocap.hostname} if mocap.hostname else {}
        self._settings = Settings(mocap.type or "", {**(default_options or {}), **host, **options})
        self._system = f"{mocap.type} at {mocap.hostname or 'this computer'}"
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._problem = ""

    @property
    def problem(self) -> str:
        """Sentence that says why no poses come; empty while frames come."""
        return self._problem

    def _say(self, problem: str) -> None:
        if problem and problem != self._problem:
            log.warning("%s", problem)
        self._problem = problem

    @property
    def reader_pid(self) -> int | None:
        """Process id of the reading process; None while there is none."""
        process = self._process
        return process.pid if process is not None else None

    def start(self) -> None:
        """Start reading; a second call does nothing."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="mocap", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End the reading process and the thread."""
        thread, self._thread = self._thread, None
        self._stopped.set()
        if thread is not None:
            thread.join()

    def _run(self) -> None:
        command = [
            sys.executable,
            "-m",
            "onboard.mocap.sdk_process",
            msgspec.json.encode(self._settings).decode(),
        ]
        while not self._stopped.is_set():
            # the process ends with this thread, as it requests from the kernel; this thread lives
            # until `stop`
            with subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, bufsize=0
            ) as process:
                self._process = process
                try:
                    self._take_frames(process)
                finally:
                    self._process = None
                    process.kill()
            self._stopped.wait(_AGAIN_S)

    def _take_frames(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        pipe, pending = process.stdout.fileno(), bytearray()
        poller = select.poll()  # select.select knows no descriptors above 1023
        poller.register(pipe, select.POLLIN)
        heard_s, patience_s = time.monotonic(), CONNECT_S
        while not self._stopped.is_set():
            if not poller.poll(100):
                if time.monotonic() - heard_s > patience_s:
                    since = "anything" if patience_s == CONNECT_S else "more"
                    self._say(
                        f"{self._system} did not send {since} for {patience_s:.0f} s. Check that it streams, "
                        "mocap.hostname and the network. The reading process starts again now."
                    )
                    return
                continue
            data = os.read(pipe, 1 << 16)
            if not data:
                self._say(
                    self._problem
                    or f"The process that reads {self._system} ended; starting it again."
                )
                return
            pending += data
            while (frame := next_frame(pending)) is not None:
                if isinstance(frame, str):
                    self._on_malformed()
                    self._say(f"The process that reads {self._system} wrote invalid data: {frame}.")
                    return
                if frame.problem:
                    self._say(frame.problem)
                    continue
                self._say("")
                heard_s, patience_s = time.monotonic(), QUIET_S
                for pose in self._converter.poses(frame):
                    if self._body in ("*", pose.body):
                        self._on_pose(pose, frame.arrived_ns)


def next_frame(pending: bytearray) -> RawFrame | str | None:
    """Take the first frame off ``pending``: a text if it is invalid, None if it is not complete
    yet.
    """
    if len(pending) < 4:
        return None
    size = int.from_bytes(pending[:4], "little")
    if size > _LARGEST_FRAME:
        return f"{size} bytes announced"
    if len(pending) < 4 + size:
        return None
    data = bytes(pending[4 : 4 + size])
    del pending[: 4 + size]
    try:
        return _decoder.decode(data)
    except msgspec.DecodeError as error:
        return str(error)


def _text(value: str | int | float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
