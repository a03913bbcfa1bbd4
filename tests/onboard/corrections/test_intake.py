from __future__ import annotations

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.autopilot import Snapshot
from onboard.bus.schema import Corrections
from onboard.config.corrections import CorrectionsConfig
from onboard.corrections.intake import MAX_WAITING, CorrectionsIntake
from onboard.corrections.status import STEADY_S, BaseFault
from tests.onboard.corrections.rtcm_frames import (
    STATION,
    ZURICH_DEG,
    ZURICH_HEIGHT_M,
    base_frame,
    ecef_frame,
    epoch,
    framed,
    observations,
)

S = 1_000_000_000
TICK = 20_000_000
CONFIG = CorrectionsConfig(source="tcp", address="localhost:2101")


class Vehicle:
    """An intake, its clock, and what its PX4 gets."""

    def __init__(self, corrections: CorrectionsConfig = CONFIG) -> None:
        self.intake = CorrectionsIntake(corrections)
        self.now_ns = 100 * S
        self.is_on_ground = True
        self.given: list[bytes] = []  # whole frames
        self._pieces: list[bytes] = []

    def hear(self, *frames: bytes, boot_id: int = 1, age_s: float = 0.01) -> None:
        for sequence, frame in enumerate(frames):
            message = Corrections(
                source="corrections",
                boot_id=boot_id,
                sequence=sequence,
                stamp_ns=self.now_ns - round(age_s * S),
                frame=frame,
            )
            self.intake.hear(message, self.now_ns, is_on_ground=self.is_on_ground)

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.now_ns += TICK
            fragment = self.intake.due(self.now_ns)
            if fragment is None:
                continue
            self._pieces.append(fragment.data)
            is_last = not fragment.flags & 1 or len(fragment.data) < 180 or len(self._pieces) == 4
            if is_last:
                self.given.append(b"".join(self._pieces))
                self._pieces.clear()

    def status(self, snapshot: Snapshot | None = None):
        return self.intake.status(snapshot or Snapshot(), self.now_ns)


def test_frames_of_a_base_reach_px4_whole_and_in_their_order():
    vehicle = Vehicle()
    frames = [base_frame(), *epoch(0, size=400), *epoch(1, size=120)]
    vehicle.hear(*frames)
    vehicle.tick(40)

    assert vehicle.given == frames
    assert vehicle.status().base_id == STATION
    # the stamp was 10 ms old, and the newest observations left seven frames later
    assert 0.0 < vehicle.status().age_s < 1.0


def test_nothing_of_a_base_is_given_before_it_has_said_where_it_is():
    vehicle = Vehicle()
    vehicle.hear(*epoch(0))
    vehicle.tick(20)
    assert vehicle.given == []
    assert vehicle.status().age_s == math.inf

    vehicle.hear(base_frame(), *epoch(1))
    vehicle.tick(20)
    assert vehicle.given == [base_frame(), *epoch(1)]


def test_the_age_is_that_of_the_newest_observations_and_grows():
    vehicle = Vehicle()
    vehicle.hear(base_frame(), *epoch(0))
    vehicle.tick(10)
    young_s = vehicle.status().age_s
    vehicle.now_ns += 3 * S
    assert vehicle.status().age_s == pytest.approx(young_s + 3.0)

    # where the base is tells nothing of what it measures
    vehicle.hear(base_frame())
    vehicle.tick(5)
    assert vehicle.status().age_s == pytest.approx(young_s + 3.1)


@pytest.mark.parametrize(
    ("frame", "count"),
    [
        (b"", "malformed"),
        (b"\xd3", "malformed"),
        (observations()[:-1], "malformed"),
        (random.Random(2).randbytes(300), "malformed"),
        (observations(size=800), "refused"),
        (observations(station=STATION + 1), "refused"),
    ],
)
def test_what_px4_must_not_get_is_counted(frame, count):
    vehicle = Vehicle()
    vehicle.hear(base_frame())
    vehicle.tick(2)
    vehicle.hear(frame)
    vehicle.tick(10)

    assert vehicle.given == [base_frame()]
    assert getattr(vehicle.intake.counts, count) == 1


def test_a_frame_that_no_fragments_hold_is_told_of():
    vehicle = Vehicle()
    vehicle.hear(base_frame(), observations(size=1000))
    assert vehicle.status().too_long_bytes == 1006
    vehicle.now_ns += 61 * S
    assert vehicle.status().too_long_bytes == 0


def test_messages_of_makers_are_no_trouble_and_go_nowhere():
    vehicle = Vehicle()
    vehicle.hear(base_frame(), framed(b"\xfe\x80" + 40 * b"\1"))
    vehicle.tick(5)
    assert vehicle.given == [base_frame()]
    assert vehicle.intake.counts.refused == vehicle.intake.counts.malformed == 0


@pytest.mark.parametrize("age_s", [2.1, 3600.0, -0.2, -86400.0])
def test_old_ones_and_those_of_the_future_are_not_given(age_s):
    vehicle = Vehicle()
    vehicle.hear(base_frame())
    vehicle.hear(*epoch(0), age_s=age_s)
    vehicle.tick(20)
    assert vehicle.given == [base_frame()]
    assert vehicle.intake.counts.late == 3


def test_what_waited_too_long_is_not_given_any_more():
    vehicle = Vehicle()
    vehicle.hear(base_frame(), *epoch(0))
    vehicle.now_ns += 3 * S
    vehicle.tick(20)
    assert vehicle.given == []
    assert vehicle.intake.counts.late == 4


def test_of_a_flood_the_newest_frames_are_kept_and_one_fragment_leaves_at_a_tick():
    vehicle = Vehicle()
    vehicle.hear(base_frame())
    vehicle.tick(1)
    flood = [observations(size=170, time_ms=number) for number in range(60)]
    vehicle.hear(*flood)

    vehicle.tick(10)
    assert vehicle.given == [base_frame(), *flood[-MAX_WAITING:][:10]]
    vehicle.tick(100)
    assert vehicle.given == [base_frame(), *flood[-MAX_WAITING:]]
    assert vehicle.intake.counts.dropped == 60 - MAX_WAITING


def test_a_flood_never_cuts_the_frame_that_is_being_sent():
    vehicle = Vehicle()
    first = observations(size=700)
    vehicle.hear(base_frame(), first)
    vehicle.tick(2)
    vehicle.hear(*(observations(size=170, time_ms=number) for number in range(40)))
    vehicle.tick(4)
    assert vehicle.given[:2] == [base_frame(), first]


def test_a_second_source_is_not_mixed_in_until_the_first_is_gone():
    vehicle = Vehicle()
    vehicle.hear(base_frame(), *epoch(0))
    vehicle.hear(base_frame(east_m=1.0), *epoch(7), boot_id=2)
    vehicle.tick(20)
    assert vehicle.given == [base_frame(), *epoch(0)]
    assert vehicle.status().has_several_sources

    vehicle.now_ns += 6 * S
    vehicle.hear(base_frame(east_m=1.0), *epoch(8), boot_id=2)
    vehicle.tick(20)
    assert vehicle.given[4:] == [base_frame(east_m=1.0), *epoch(8)]
    assert not vehicle.status().has_several_sources


# -- the base --------------------------------------------------------------------------------------

SURVEYED = CorrectionsConfig(
    source="tcp", address="localhost:2101", base_deg=ZURICH_DEG, base_tolerance_m=1.0
)


@pytest.mark.parametrize("is_on_ground", [True, False])
def test_a_base_elsewhere_than_surveyed_is_never_believed(is_on_ground):
    vehicle = Vehicle(SURVEYED)
    vehicle.is_on_ground = is_on_ground
    vehicle.hear(base_frame(east_m=0.9), *epoch(0))
    vehicle.tick(20)
    assert len(vehicle.given) == 4

    vehicle.hear(base_frame(east_m=1.2), *epoch(1))
    vehicle.tick(20)
    assert len(vehicle.given) == 4
    status = vehicle.status()
    assert status.base.fault is BaseFault.ELSEWHERE
    assert status.base.by_m == pytest.approx(1.2, abs=0.01)


@pytest.mark.parametrize(("up_m", "is_believed"), [(0.5, True), (-0.5, True), (3.0, False)])
def test_a_surveyed_height_is_judged_too(up_m, is_believed):
    surveyed = CorrectionsConfig(
        source="tcp",
        address="localhost:2101",
        base_deg=ZURICH_DEG,
        base_height_m=ZURICH_HEIGHT_M,
        base_tolerance_m=1.0,
    )
    vehicle = Vehicle(surveyed)
    vehicle.hear(base_frame(height_m=ZURICH_HEIGHT_M + up_m))
    vehicle.tick(1)
    assert bool(vehicle.given) is is_believed


def test_a_base_that_jumps_in_flight_is_not_believed_until_it_is_back_or_the_vehicle_landed():
    vehicle = Vehicle()
    vehicle.hear(base_frame(), *epoch(0))
    vehicle.tick(20)
    assert len(vehicle.given) == 4
    vehicle.is_on_ground = False

    vehicle.hear(base_frame(east_m=10.0), *epoch(1))
    vehicle.tick(20)
    assert len(vehicle.given) == 4
    assert vehicle.status().base.fault is BaseFault.MOVED
    assert vehicle.status().base.by_m == pytest.approx(10.0, abs=0.01)

    vehicle.hear(base_frame(), *epoch(2))
    vehicle.tick(20)
    assert len(vehicle.given) == 8
    assert vehicle.status().base.fault is None

    vehicle.hear(base_frame(east_m=10.0), *epoch(3))
    vehicle.is_on_ground = True
    vehicle.hear(base_frame(east_m=10.0), *epoch(4))
    vehicle.tick(20)
    assert vehicle.given[8:] == [base_frame(east_m=10.0), *epoch(4)]


def test_a_base_that_creeps_is_compared_with_where_it_was_at_first():
    vehicle = Vehicle()
    vehicle.hear(base_frame())
    vehicle.is_on_ground = False
    faults = []
    for step in range(1, 31):
        vehicle.hear(base_frame(east_m=0.1 * step))
        faults.append(vehicle.status().base.fault)
    assert faults[:19] == [None] * 19
    assert faults[-1] is BaseFault.MOVED


def test_another_base_in_flight_is_not_believed():
    vehicle = Vehicle()
    vehicle.hear(base_frame())
    vehicle.is_on_ground = False
    vehicle.hear(base_frame(station=99), *epoch(1, station=99))
    vehicle.tick(20)
    assert vehicle.given == [base_frame()]
    assert vehicle.status().base.fault is BaseFault.REPLACED


def test_a_base_that_is_nowhere_is_not_believed():
    vehicle = Vehicle()
    vehicle.hear(ecef_frame((0.0, 0.0, 0.0)), *epoch(0))
    vehicle.tick(20)
    assert vehicle.given == []
    assert vehicle.status().base.fault is BaseFault.NOWHERE


def test_a_base_that_moved_on_the_ground_has_to_be_steady_for_a_while():
    vehicle = Vehicle()
    vehicle.hear(base_frame())
    assert vehicle.status().unsteady_s is None
    vehicle.hear(base_frame(east_m=5.0))
    vehicle.now_ns += 2 * S
    assert vehicle.status().unsteady_s == pytest.approx(2.0)
    vehicle.now_ns += round(STEADY_S * S)
    assert vehicle.status().unsteady_s is None


def test_the_distance_to_the_base_is_counted_from_where_px4_is():
    vehicle = Vehicle()
    vehicle.hear(base_frame(east_m=-2400.0))
    # PX4's own origin, and 300 m north and 600 m east of it
    snapshot = Snapshot(
        global_origin=(*ZURICH_DEG, 490.0),
        position_local_ned_m=(300.0, 600.0, -10.0),
        local_position_ns=1,
    )
    assert vehicle.status(snapshot).base_distance_m == pytest.approx(3014.96, rel=0.004)
    assert math.isnan(vehicle.status().base_distance_m)


@given(data=st.data())
@settings(max_examples=8, deadline=None)
def test_whatever_comes_px4_gets_only_whole_frames_of_the_believed_base(data):
    vehicle = Vehicle()
    good = [base_frame(), *epoch(0), *epoch(1, size=700)]
    frames = data.draw(
        st.lists(
            st.one_of(
                st.sampled_from(good),
                st.binary(max_size=50),
                st.sampled_from([base_frame(east_m=50.0), observations(station=7)]),
            ),
            max_size=15,
        )
    )
    for frame in frames:
        vehicle.hear(frame, boot_id=data.draw(st.integers(1, 2)))
        vehicle.is_on_ground = data.draw(st.booleans())
        vehicle.tick(data.draw(st.integers(0, 3)))
    vehicle.tick(200)

    assert set(vehicle.given) <= {*good, base_frame(east_m=50.0)}
