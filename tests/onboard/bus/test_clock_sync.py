"""Messages put on our own clock, and two processes whose monotonic clocks are really apart."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from typing import Any

import pytest

from onboard.bus.clock_sync import ClockNode, host_id
from onboard.bus.schema import ClockMessage, Event, HeardClock, MocapPose, Order, TickBatch
from onboard.bus.session import BusSession
from tests.groundstation.recorded import tick

_MS = 1_000_000
_S = 1_000_000_000
_SHIFT_S = 5000
_IN_ANOTHER_TIME = [
    "unshare",
    "--time",
    "--fork",
    "--kill-child",
    "--monotonic",
    str(_SHIFT_S),
    "-r",
]


def _node(*, ahead_s: float = 100.0) -> ClockNode:
    """A node that has measured ``other`` on another host, 1 ms each way; nothing is opened."""
    node = ClockNode(BusSession(namespace="covey/test", node="own"))
    ahead_ns = int(ahead_s * 1e9)
    heard = HeardClock("own", node.clocks.host, 9 * _S, 9 * _S + ahead_ns + _MS)
    sent_ns = 10 * _S + ahead_ns - _MS
    node.clocks.hear(
        ClockMessage(node="other", host=1, sequence=1, sent_ns=sent_ns, heard=(heard,)), 10 * _S
    )
    return node


def _pose(stamp_ns: int, source: str) -> MocapPose:
    return MocapPose(
        body="a",
        boot_id=1,
        sequence=1,
        stamp_ns=stamp_ns,
        is_tracked=True,
        position_enu_m=(0.0, 0.0, 0.0),
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
        source=source,
    )


def test_a_pose_of_another_host_is_aged_by_its_offset_and_the_bound() -> None:
    found = _node().pose(_pose(110 * _S - 20 * _MS, "other"), 10 * _S)
    assert found is not None
    assert 10 * _S - 24 * _MS < found.stamp_ns <= 10 * _S - 21 * _MS


def test_a_pose_whose_clock_is_not_measured_is_not_used() -> None:
    assert _node().pose(_pose(10 * _S, "somebody"), 10 * _S) is None


def test_a_source_that_never_tells_its_clock_is_named_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    node = _node()
    for second in range(10, 30):
        node.pose(_pose(second * _S, "somebody"), second * _S)
    (record,) = caplog.records
    assert "'somebody'" in record.getMessage()


def test_a_pose_without_a_source_is_of_our_own_clock() -> None:
    pose = _pose(10 * _S, "")
    assert _node().pose(pose, 10 * _S) is pose


def test_an_orders_deadline_comes_as_far_after_it_on_our_clock_as_on_the_senders() -> None:
    for ahead_s in (-3600.0, 0.3, 100.0):
        sent_ns = 10 * _S + int(ahead_s * 1e9) - 5 * _MS
        deadline_ns = sent_ns + 2 * _S
        order = Order(
            order_id="1",
            author="x",
            kind="land",
            stamp_ns=sent_ns,
            deadline_ns=deadline_ns,
            node="other",
        )
        received = _node(ahead_s=ahead_s).order(order, 10 * _S)
        assert received.deadline_ns - received.stamp_ns == 2 * _S
        assert 10 * _S - 12 * _MS < received.stamp_ns <= 10 * _S


def test_an_order_without_a_deadline_keeps_none() -> None:
    order = Order(order_id="1", author="x", kind="land", stamp_ns=1, deadline_ns=0, node="other")
    assert _node().order(order, 10 * _S).deadline_ns == 0


def test_a_record_has_events_and_all_ticks_of_a_batch_on_our_clock() -> None:
    node = _node()
    arrival_ns = 10 * _S
    event = Event(
        vehicle="other", stamp_ns=110 * _S - 20 * _MS, severity="info", code="x", sentence="x"
    )
    found = node.any_message("other", event, arrival_ns)
    assert isinstance(found, Event)
    assert arrival_ns - 24 * _MS < found.stamp_ns <= arrival_ns - 21 * _MS

    stamps_ns = [110 * _S - 40 * _MS, 110 * _S - 20 * _MS]
    batch = TickBatch(
        vehicle="other", boot_id=1, sequence=1, ticks=tuple(tick(stamp) for stamp in stamps_ns)
    )
    ticks = node.any_message("other", batch, arrival_ns)
    assert isinstance(ticks, TickBatch)
    older, newest = ticks.ticks
    assert newest.stamp_ns == found.stamp_ns
    assert newest.stamp_ns - older.stamp_ns == 20 * _MS


@pytest.mark.parametrize(
    ("stamp_ns", "expected_ns"),
    [(10 * _S - 600 * _MS, 10 * _S - 600 * _MS), (5000 * _S, 10 * _S - 20 * _MS)],
    ids=["near", "far"],
)
def test_a_record_has_messages_of_an_unmeasured_clock_near_their_arrival(
    stamp_ns: int, expected_ns: int
) -> None:
    event = Event(vehicle="new", stamp_ns=stamp_ns, severity="info", code="x", sentence="x")
    found = _node().any_message("new", event, 10 * _S)
    assert isinstance(found, Event)
    assert found.stamp_ns == expected_ns


def test_a_record_keeps_late_messages_whose_sender_has_no_name() -> None:
    pose = _pose(9 * _S, "")
    assert _node().any_message("a", pose, 10 * _S) is pose


def test_processes_of_this_host_have_one_host_id() -> None:
    code = "from onboard.bus.clock_sync import host_id; print(host_id())"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(other.stdout) == host_id()


_OTHER_PROCESS = """
import json, sys, time
from onboard.bus.clock_sync import ClockNode
from onboard.bus.session import BusSession
from tests.groundstation.recorded import tick
listen, connect, own, other = sys.argv[1:]
bus = BusSession(namespace="covey/clocks", node=own, listen=[listen], connect=[connect])
node = ClockNode(bus)
bus.start(); node.start()
end = time.monotonic() + 20.0
while time.monotonic() < end and not node.clocks.is_measured(other):
    node.beat(); time.sleep(0.1)
for _ in range(15):
    node.beat(); time.sleep(0.1)
found = node.clocks.offset_s(other, time.monotonic_ns())
print(json.dumps({"offset": found}), flush=True)
time.sleep(1.0)
bus.stop()
"""


def _ports() -> list[str]:
    found = []
    for _ in range(2):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            found.append(f"tcp/127.0.0.1:{probe.getsockname()[1]}")
    return found


def _can_shift_time() -> bool:
    try:
        found = subprocess.run([*_IN_ANOTHER_TIME, "true"], capture_output=True, timeout=10)
    except (FileNotFoundError, subprocess.TimeoutExpired):
        return False
    return found.returncode == 0


needs_time_namespace = pytest.mark.skipif(
    not _can_shift_time(), reason="this kernel allows no time namespaces"
)


@needs_time_namespace
def test_two_processes_with_clocks_really_apart_measure_each_other() -> None:
    here, there = _ports()
    command = [sys.executable, "-c", _OTHER_PROCESS]
    with (
        subprocess.Popen(
            [*command, here, there, "one", "two"], stdout=subprocess.PIPE, text=True
        ) as one,
        subprocess.Popen(
            [*_IN_ANOTHER_TIME, *command, there, here, "two", "one"],
            stdout=subprocess.PIPE,
            text=True,
        ) as two,
    ):
        found = [json.loads(process.communicate(timeout=60)[0]) for process in (one, two)]
    for told, truth_s in zip(found, (_SHIFT_S, -_SHIFT_S), strict=True):
        offset_s, bound_s = told["offset"]
        assert abs(offset_s - truth_s) <= bound_s + 1e-6
        assert bound_s < 0.05


def test_each_beat_tells_what_time_it_is_in_the_world() -> None:
    told: list[Any] = []
    node = _node()
    bus = node._bus
    assert isinstance(bus, BusSession)
    bus.publish = lambda topic, name, message: told.append(message)  # type: ignore[method-assign]
    before_ns = time.time_ns()
    node.beat()
    assert before_ns <= told[0].world_ns <= time.time_ns()
