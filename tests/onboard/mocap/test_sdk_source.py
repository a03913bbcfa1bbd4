"""Frames of a motion capture into poses; the real package reads a NatNet server of our own."""

from __future__ import annotations

import importlib.util
import itertools
import math
import os
import signal
import time
from pathlib import Path
from typing import Any

import msgspec
import pytest

from onboard.bus.schema import MocapPose
from onboard.config.mocap import MocapConfig
from onboard.mocap import sdk_source
from onboard.mocap.sdk_process import RawFrame
from onboard.mocap.sdk_source import PoseConverter, SdkMocap
from tests.onboard.mocap.natnet import NatNetServer, Pose

needs_package = pytest.mark.skipif(
    importlib.util.find_spec("motioncapture") is None,
    reason="the optional package 'motioncapture' is not installed",
)
_MOCK = MocapConfig(source="motioncapture", type="mock")
_LEVEL = (1.0, 0.0, 0.0, 0.0)
_MS = 1_000_000


def _frame(at_ms: int, *bodies: str) -> RawFrame:
    return RawFrame(at_ms * _MS, {body: ((float(at_ms), 0.0, 1.0), _LEVEL) for body in bodies})


def test_the_systems_latency_comes_off_the_arrival() -> None:
    poses = PoseConverter(msgspec.structs.replace(_MOCK, latency_s=0.012), boot_id=7)
    (pose,) = poses.poses(_frame(500, "a"))
    assert pose.stamp_ns == 488 * _MS
    assert (pose.boot_id, pose.sequence, pose.is_tracked) == (7, 1, True)


def test_a_body_that_leaves_the_frames_is_passed_on_as_lost_and_then_forgotten() -> None:
    poses = PoseConverter(_MOCK, boot_id=7)
    told = {
        at: poses.poses(_frame(at, "a", *(["b"] if at < 100 else [])))
        for at in range(0, 12_000, 20)
    }
    of_b = {at: [pose for pose in found if pose.body == "b"] for at, found in told.items()}
    assert all(pose.is_tracked for at in range(0, 100, 20) for pose in of_b[at])
    assert not of_b[140]  # a frame without it now and then says nothing
    (lost,) = of_b[300]
    assert not lost.is_tracked
    assert lost.position_enu_m[0] == 80.0
    assert lost.stamp_ns == 290 * _MS  # the stamp goes on, so that it is known to be looked for
    assert not of_b[11_000]


def test_frames_beyond_the_highest_rate_are_left_out_evenly() -> None:
    poses = PoseConverter(msgspec.structs.replace(_MOCK, max_rate_hz=100.0), boot_id=7)
    taken = [at for at in range(0, 1000, 4) if poses.poses(_frame(at, "a"))]
    assert 95 <= len(taken) <= 101
    assert max(b - a for a, b in itertools.pairwise(taken)) <= 12


def test_a_frame_that_comes_a_little_early_is_not_left_out() -> None:
    poses = PoseConverter(msgspec.structs.replace(_MOCK, max_rate_hz=100.0), boot_id=7)
    stamps = [at * 10 * _MS + (at % 3 - 1) * _MS // 2 for at in range(100)]
    assert all(poses.poses(RawFrame(stamp, {"a": ((0.0, 0.0, 0.0), _LEVEL)})) for stamp in stamps)


class _Listener:
    """Takes poses on the source's thread."""

    def __init__(self, mocap: MocapConfig, body: str = "*", **options: str) -> None:
        self.poses: list[tuple[MocapPose, int]] = []
        self.malformed = 0
        self.source = SdkMocap(
            mocap,
            body,
            lambda pose, at_ns: self.poses.append((pose, at_ns)),
            self._count,
            default_options=options,
        )

    def _count(self) -> None:
        self.malformed += 1

    def __enter__(self) -> _Listener:
        self.source.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.source.stop()

    def wait(self, condition, *, seconds: float = 45.0) -> None:
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, (
                f"waited {seconds} s in vain; problem: {self.source.problem!r}"
            )
            time.sleep(0.01)


def _circle() -> dict[str, Pose | None]:
    turn = time.monotonic()
    moving: Pose = (
        (math.cos(turn), math.sin(turn), 1.0),
        (0.0, 0.0, math.sin(turn / 2), math.cos(turn / 2)),
    )
    return {"mav0": moving, "mav1": ((2.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)), "hidden": None}


def _optitrack(server: NatNetServer, **more: Any) -> MocapConfig:
    return MocapConfig(
        source="motioncapture",
        type="optitrack",
        hostname="localhost",
        options={"port_command": server.port},
        **more,
    )


@needs_package
def test_moving_bodies_of_a_natnet_server_arrive_turned_into_the_fleets_frame() -> None:
    frame = {"yaw_deg": 90.0, "offset_m": (0.0, 0.0, 0.5), "latency_s": 0.004}
    with (
        NatNetServer(["mav0", "mav1", "hidden"], _circle) as server,
        _Listener(_optitrack(server, **frame)) as heard,
    ):
        heard.wait(lambda: len(heard.poses) > 60)
        problem = heard.source.problem
    assert problem == ""
    assert {pose.body for pose, _ in heard.poses} == {"mav0", "mav1"}
    for pose, received_ns in heard.poses:
        x, y, z = pose.position_enu_m
        late_ns = received_ns - pose.stamp_ns  # the latency of the file, and the way to the agent
        assert 4 * _MS <= late_ns < 1000 * _MS
        w, _, _, qz = pose.quaternion_enu_flu_wxyz
        if pose.body == "mav1":
            assert (x, y, z) == pytest.approx((0.0, 2.0, 1.5), abs=1e-6)
        else:
            assert z == pytest.approx(1.5, abs=1e-6)
            # its heading is its place on the circle, and both are turned by the same quarter
            miss = math.atan2(y, x) - 2.0 * math.atan2(qz, w)
            assert math.remainder(miss, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-5)
    stamps = [pose.stamp_ns for pose, _ in heard.poses if pose.body == "mav0"]
    assert all(later > earlier for earlier, later in itertools.pairwise(stamps))


@needs_package
def test_only_the_body_that_was_asked_for_is_called_back() -> None:
    with (
        NatNetServer(["mav0", "mav1"], _circle) as server,
        _Listener(_optitrack(server), "mav1") as heard,
    ):
        heard.wait(lambda: len(heard.poses) > 10)
        assert {pose.body for pose, _ in heard.poses} == {"mav1"}


@needs_package
def test_a_reading_process_that_dies_is_started_again_and_its_poses_count_on() -> None:
    with NatNetServer(["mav0"], _circle) as server, _Listener(_optitrack(server)) as heard:
        heard.wait(lambda: len(heard.poses) > 5)
        victim = heard.source.reader_pid
        assert victim is not None
        os.kill(victim, signal.SIGKILL)
        heard.wait(lambda: heard.source.problem != "")
        count = len(heard.poses)
        heard.wait(lambda: len(heard.poses) > count + 5 and heard.source.problem == "")
        assert heard.source.reader_pid not in (None, victim)
    sequences = [pose.sequence for pose, _ in heard.poses]
    assert sequences == sorted(set(sequences))
    assert len({pose.boot_id for pose, _ in heard.poses}) == 1


@needs_package
def test_a_signal_to_the_agents_processes_does_not_end_the_poses_that_it_lands_by() -> None:
    with NatNetServer(["mav0"], _circle) as server, _Listener(_optitrack(server)) as heard:
        heard.wait(lambda: len(heard.poses) > 5)
        reader = heard.source.reader_pid
        assert reader is not None
        os.kill(reader, signal.SIGTERM)
        os.kill(reader, signal.SIGINT)
        os.kill(reader, signal.SIGHUP)
        count = len(heard.poses)
        heard.wait(lambda: len(heard.poses) > count + 20)
        assert heard.source.reader_pid == reader


@needs_package
def test_a_system_that_falls_silent_is_named_and_read_again_when_it_is_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sdk_source, "QUIET_S", 0.5)
    with NatNetServer(["mav0"], _circle) as server, _Listener(_optitrack(server)) as heard:
        heard.wait(lambda: len(heard.poses) > 5)
        server.is_streaming.clear()
        heard.wait(lambda: "optitrack at localhost did not send more" in heard.source.problem)
        server.is_streaming.set()
        heard.wait(lambda: heard.source.problem == "")


@needs_package
def test_nobody_at_the_address_is_said_in_time_although_the_package_hangs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sdk_source, "CONNECT_S", 1.5)
    mocap = MocapConfig(source="motioncapture", type="vicon", hostname="127.0.0.1")
    with _Listener(mocap) as heard:
        heard.wait(lambda: "vicon at 127.0.0.1 did not send anything" in heard.source.problem)
        pid = heard.source.reader_pid
    assert pid is None or not os.path.exists(f"/proc/{pid}")


@needs_package
@pytest.mark.parametrize(
    ("type_", "words"),
    [("motionanalysis", "cannot read motionanalysis"), ("qualisys", "Check mocap.hostname")],
)
def test_what_the_package_refuses_is_a_sentence(type_: Any, words: str) -> None:
    with _Listener(MocapConfig(source="motioncapture", type=type_, hostname="127.0.0.1")) as heard:
        heard.wait(lambda: words in heard.source.problem)


def test_without_the_package_the_sentence_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "motioncapture.py").write_text(
        "raise ModuleNotFoundError('no', name='motioncapture')\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with _Listener(_MOCK) as heard:
        heard.wait(lambda: "pip install 'motioncapture" in heard.source.problem)


def test_a_reading_process_that_writes_nonsense_is_counted_and_replaced(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "motioncapture.py").write_text(
        "import os\ndef connect(type, options):\n"
        "    for fd in range(3, 9):\n"
        "        try: os.write(fd, b'\\x08\\x00\\x00\\x00garbage!')\n"
        "        except OSError: pass\n"
        "    raise SystemExit(0)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with _Listener(_MOCK) as heard:
        heard.wait(lambda: heard.malformed >= 2)
    assert not heard.poses


def test_bytes_are_frames_only_when_they_are_whole_and_sound() -> None:
    data = msgspec.msgpack.encode(_frame(3, "a"))
    whole = len(data).to_bytes(4, "little") + data
    for cut in range(len(whole)):
        assert sdk_source.next_frame(bytearray(whole[:cut])) is None
    pending = bytearray(whole + whole[:5])
    assert isinstance(sdk_source.next_frame(pending), RawFrame)
    assert bytes(pending) == whole[:5]
    assert isinstance(sdk_source.next_frame(bytearray(b"\xff\xff\xff\xff")), str)


def test_a_frame_whose_name_is_no_text_is_invalid() -> None:
    data = msgspec.msgpack.encode(_frame(3, "name")).replace(b"name", b"n\x80me")
    frame = len(data).to_bytes(4, "little") + data
    assert isinstance(sdk_source.next_frame(bytearray(frame)), str)


def test_a_reading_process_that_cannot_be_started_is_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    started: list[int] = []

    def refuse(*_args: object, **_keywords: object) -> None:
        started.append(1)
        raise OSError("Cannot allocate memory")

    monkeypatch.setattr("subprocess.Popen", refuse)
    monkeypatch.setattr(sdk_source, "_AGAIN_S", 0.001)
    mocap = SdkMocap(_MOCK, "*", lambda pose, received_ns: None, lambda: None)
    mocap.start()
    try:
        deadline_s = time.monotonic() + 5.0
        while len(started) < 3 and time.monotonic() < deadline_s:
            time.sleep(0.005)
        assert len(started) >= 3
        assert "cannot be started (Cannot allocate memory); trying again" in mocap.problem
    finally:
        mocap.stop()
