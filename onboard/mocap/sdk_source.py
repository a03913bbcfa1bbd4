"""Mocap poses from a motion-capture system that another process reads.

That process is :mod:`onboard.mocap.sdk_process`. A thread starts it, converts its frames to poses
in the fleet frame, and restarts it when it has ended or has sent nothing for a while. A body that
is missing from the frames is passed on as not tracked, so that it is not mistaken for a dead
source.
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
from onboard.mocap.mocap_frame import MocapFrame
from onboard.mocap.sdk_process import RawFrame, Settings
from onboard.mocap.source import OnMalformed, OnPose

_LOST_NS = 100_000_000  # a body missing for this time is passed on as not tracked
_FORGOTTEN_NS = 10_000_000_000  # a body missing for this time is no longer passed on
QUIET_S = 2.0  # the reading process is restarted after this time without further frames
CONNECT_S = 5.0  # the reading process is restarted after this time without a first frame
_AGAIN_S = 1.0  # pause before the reading process is restarted
_POLL_MS = 100  # a stop is noticed within this time
_LENGTH_BYTES = 4  # size of the length prefix of each frame in the pipe
_LARGEST_FRAME = 1 << 20  # largest frame [bytes]

log = logging.getLogger("covey.mocap")
_decoder = msgspec.msgpack.Decoder(RawFrame)


@dataclass(slots=True)
class PoseConverter:
    """Converts frames of the system to poses on the bus. No I/O.

    It converts the coordinates, sets stamps and sequence numbers, and notices lost bodies.
    """

    mocap: MocapConfig
    boot_id: int  # random number of this source
    source: str = ""  # node whose clock stamps the poses
    sequence: int = 0  # number of converted frames
    _next_ns: int = 0  # time at which the next frame is due, at the largest rate
    _frame: MocapFrame = field(init=False)
    _latency_ns: int = field(init=False)
    _period_ns: int = field(init=False)  # time between two frames at the largest rate
    _last: dict[str, MocapPose] = field(default_factory=dict)  # body -> its last tracked pose

    def __post_init__(self) -> None:
        self._frame = MocapFrame.of(self.mocap)
        self._latency_ns = int(self.mocap.latency_s * 1e9)
        self._period_ns = int(1e9 / self.mocap.max_rate_hz)

    def poses(self, raw: RawFrame) -> list[MocapPose]:
        """Return the poses of one frame; none if the frame exceeds the configured rate.

        A missing body is returned as not tracked, from 0.1 s to 10 s after its last pose.
        """
        earliest_ns = self._next_ns - self._period_ns // 10  # a tenth of a period early is allowed
        if raw.arrived_ns < earliest_ns:
            return []

        # The next frame is due one period after this frame was due. After a late frame, the next
        # one may come up to one period earlier, but not more.
        self._next_ns = max(self._next_ns, raw.arrived_ns - self._period_ns) + self._period_ns
        self.sequence += 1
        stamp_ns = raw.arrived_ns - self._latency_ns

        poses: list[MocapPose] = []
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

        missing = [body for body in self._last if body not in raw.bodies]
        for body in missing:
            last = self._last[body]
            lost_ns = stamp_ns - last.stamp_ns
            if lost_ns > _FORGOTTEN_NS:
                del self._last[body]
            elif lost_ns > _LOST_NS:
                pose = msgspec.structs.replace(
                    last, sequence=self.sequence, stamp_ns=stamp_ns, is_tracked=False
                )
                poses.append(pose)
        return poses


class SdkMocap:
    """A motion-capture system that the package ``motioncapture`` reads.

    It calls the callbacks on its own thread.

    Args:
        mocap: the fleet file's table, with ``source = "motioncapture"``.
        body: name of the body; ``*`` for all bodies.
        on_pose: called with each pose and the monotonic time [ns] of its arrival.
        on_malformed: called for bytes that are not a frame.
        node: node that publishes the poses on the bus; empty if they stay in this process.
        default_options: options for the package; options in the fleet file override them.
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
        self._body = body
        self._on_pose = on_pose
        self._on_malformed = on_malformed
        boot_id = int.from_bytes(os.urandom(4), "little") & 0x7FFFFFFF  # 31 bits, like all boot ids
        self._converter = PoseConverter(mocap, boot_id=boot_id, source=node)

        options: dict[str, str] = {}
        if default_options is not None:
            options.update(default_options)
        if mocap.hostname:
            options["hostname"] = mocap.hostname
        for key, value in mocap.options.items():
            options[key] = _text(value)
        system_type = "" if mocap.type is None else mocap.type
        hostname = mocap.hostname if mocap.hostname else "this computer"
        self._settings = Settings(system_type, options)
        self._system = f"{mocap.type} at {hostname}"

        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._problem = ""

    @property
    def problem(self) -> str:
        """Sentence that says why no poses arrive; empty while frames arrive."""
        return self._problem

    def _set_problem(self, problem: str) -> None:
        """Remember a problem, and log it if it is new. An empty text clears the problem."""
        if problem and problem != self._problem:
            log.warning("%s", problem)
        self._problem = problem

    @property
    def reader_pid(self) -> int | None:
        """Process id of the reading process; None while there is none."""
        process = self._process
        if process is None:
            return None
        return process.pid

    def start(self) -> None:
        """Start reading; a second call does nothing."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="mocap", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End the reading process and the thread."""
        thread = self._thread
        self._thread = None
        self._stopped.set()
        if thread is not None:
            thread.join()

    def _run(self) -> None:
        """Run the reading process repeatedly until :meth:`stop`."""
        settings = msgspec.json.encode(self._settings).decode()
        command = [sys.executable, "-m", "onboard.mocap.sdk_process", settings]
        while not self._stopped.is_set():
            try:
                self._run_once(command)
            except OSError as error:  # no memory or no descriptor for another process
                self._set_problem(
                    f"The process that reads {self._system} cannot be started ({error}); trying "
                    "again."
                )
            self._stopped.wait(_AGAIN_S)

    def _run_once(self, command: list[str]) -> None:
        """Start the reading process, and pass on its frames until it ends or must be restarted.

        Raises:
            OSError: the process cannot be started.
        """
        # The kernel ends the process when the thread that started it ends, so this thread must
        # live until `stop`.
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, bufsize=0
        ) as process:
            self._process = process
            try:
                self._read_frames(process)
            finally:
                self._process = None
                process.kill()

    def _read_frames(self, process: subprocess.Popen[bytes]) -> None:
        """Pass on the frames of one reading process, until it ends or must be restarted."""
        assert process.stdout is not None
        pipe = process.stdout.fileno()
        poller = select.poll()  # select.select does not support descriptors above 1023
        poller.register(pipe, select.POLLIN)

        pending = bytearray()
        has_frames = False
        last_frame_s = time.monotonic()
        while not self._stopped.is_set():
            has_data = bool(poller.poll(_POLL_MS))
            if not has_data:
                missing = "anything"
                longest_gap_s = CONNECT_S
                if has_frames:
                    missing = "more"
                    longest_gap_s = QUIET_S
                if time.monotonic() - last_frame_s > longest_gap_s:
                    self._set_problem(
                        f"{self._system} did not send {missing} for {longest_gap_s:.0f} s. Check "
                        "that it streams, mocap.hostname and the network. The reading process "
                        "starts again now."
                    )
                    return
                continue

            data = os.read(pipe, 1 << 16)
            if not data:  # the process has ended
                if not self._problem:
                    self._set_problem(
                        f"The process that reads {self._system} ended; starting it again."
                    )
                return
            pending += data

            while (frame := next_frame(pending)) is not None:
                if isinstance(frame, str):
                    self._on_malformed()
                    self._set_problem(
                        f"The process that reads {self._system} wrote invalid data: {frame}."
                    )
                    return
                if frame.problem:
                    self._set_problem(frame.problem)
                    continue

                self._set_problem("")
                has_frames = True
                last_frame_s = time.monotonic()
                self._pass_on(frame)

    def _pass_on(self, frame: RawFrame) -> None:
        received_ns = time.monotonic_ns()  # here, so that a reader that is late is noticed
        for pose in self._converter.poses(frame):
            if self._body in ("*", pose.body):
                self._on_pose(pose, received_ns)


def next_frame(pending: bytearray) -> RawFrame | str | None:
    """Remove the first frame from ``pending``, and return it.

    Returns:
        the frame; None if it is incomplete; a text that says what is wrong if it is invalid.
    """
    if len(pending) < _LENGTH_BYTES:
        return None

    size = int.from_bytes(pending[:_LENGTH_BYTES], "little")
    if size > _LARGEST_FRAME:
        return f"{size} bytes announced"
    end = _LENGTH_BYTES + size
    if len(pending) < end:
        return None

    data = bytes(pending[_LENGTH_BYTES:end])
    del pending[:end]
    try:
        return _decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        return str(error)


def _text(value: str | int | float | bool) -> str:
    """Return an option of the fleet file as the text that the package expects."""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)
