"""The emulated receiver: fragments to frames, and from a fix of 3D to RTK and back."""

from __future__ import annotations

import random

import pytest

from onboard.corrections.fragments import Fragment, fragments_of
from sitl.px4.satellite_receiver import (
    FIX_3D,
    FIXED_AFTER_S,
    FLOAT_AFTER_S,
    FLOAT_WITHOUT_S,
    LOST_WITHOUT_S,
    NO_FIX,
    RTK_FIXED,
    RTK_FLOAT,
    Assembly,
    SatelliteReceiver,
)
from tests.onboard.corrections.rtcm_frames import base_frame, epoch, observations


def hear(receiver: SatelliteReceiver, second: float, *frames: bytes) -> None:
    for sequence, frame in enumerate(frames):
        for fragment in fragments_of(frame, sequence + 4 * int(second)):
            receiver.hear(fragment.flags, fragment.data, second)


def corrected(seconds: float) -> SatelliteReceiver:
    """A receiver that has had corrections for so long, once a second."""
    receiver = SatelliteReceiver()
    for second in range(int(seconds) + 1):
        hear(receiver, second, base_frame(), *epoch(second))
    return receiver


def fix(receiver: SatelliteReceiver, time_s: float) -> int:
    return receiver.fix_type(time_s, has_fix=True)


def test_the_fix_rises_with_corrections_and_falls_without():
    receiver = SatelliteReceiver()
    assert fix(receiver, 0.0) == FIX_3D
    risen = []
    for second in range(10):
        hear(receiver, second, base_frame(), *epoch(second))
        risen.append(fix(receiver, second))
    assert risen[: int(FLOAT_AFTER_S)] == [FIX_3D] * 3
    assert risen[int(FLOAT_AFTER_S) : int(FIXED_AFTER_S)] == [RTK_FLOAT] * 5
    assert risen[int(FIXED_AFTER_S) :] == [RTK_FIXED] * 2

    last = 9.0
    assert fix(receiver, last + FLOAT_WITHOUT_S) == RTK_FIXED
    assert fix(receiver, last + FLOAT_WITHOUT_S + 0.1) == RTK_FLOAT
    assert fix(receiver, last + LOST_WITHOUT_S) == RTK_FLOAT
    assert fix(receiver, last + LOST_WITHOUT_S + 0.1) == FIX_3D
    assert receiver.fix_type(last, has_fix=False) == NO_FIX


def test_after_a_short_gap_it_floats_first_and_after_a_long_one_begins_anew():
    receiver = corrected(10)
    hear(receiver, 18.0, *epoch(18))
    assert fix(receiver, 18.0) == RTK_FLOAT
    for second in range(19, 24):
        hear(receiver, second, *epoch(second))
    assert fix(receiver, 23.0) == RTK_FIXED

    hear(receiver, 60.0, *epoch(60))
    assert fix(receiver, 60.0) == FIX_3D


def test_without_a_base_or_without_observations_nothing_rises():
    receiver = SatelliteReceiver()
    for second in range(12):
        hear(receiver, second, *epoch(second))
    assert fix(receiver, 12.0) == FIX_3D
    receiver = SatelliteReceiver()
    for second in range(12):
        hear(receiver, second, base_frame())
    assert fix(receiver, 12.0) == FIX_3D


@pytest.mark.parametrize("fault", ["is_deaf", "is_garbled"])
def test_faults_of_the_corrections_let_the_fix_fall_back(fault: str):
    receiver = corrected(9)
    assert fix(receiver, 9.0) == RTK_FIXED
    setattr(receiver, fault, True)
    for second in range(10, 26):
        hear(receiver, second, base_frame(), *epoch(second))
    assert fix(receiver, 25.0) == FIX_3D
    assert receiver.bad_frames == (0 if fault == "is_deaf" else 64)


def test_a_base_that_says_another_place_moves_a_receiver_that_believes_it():
    receiver = corrected(9)
    assert receiver.shift_m(9.0) == 0.0
    hear(receiver, 10.0, base_frame(east_m=25.0), *epoch(10))
    assert receiver.shift_m(10.0) == pytest.approx(25.0, abs=0.01)
    assert receiver.shift_m(10.0 + LOST_WITHOUT_S + 0.1) == 0.0


@pytest.mark.parametrize("size", [20, 174, 175, 354, 534, 600, 714])
def test_a_frame_of_any_length_is_whole_with_its_last_fragment(size: int):
    frame = observations(size=size)
    assembly = Assembly()
    taken = [assembly.take(one.flags, one.data, 0.0) for one in fragments_of(frame, 5)]
    assert taken[:-1] == [None] * (len(taken) - 1)
    assert taken[-1] == frame


def test_fragments_may_come_in_any_order_and_twice():
    frame = observations(size=600)
    pieces = [*fragments_of(frame, 5)] * 2
    random.Random(3).shuffle(pieces)
    assembly = Assembly()
    whole = [assembly.take(one.flags, one.data, 0.0) for one in pieces]
    assert frame in whole
    assert set(whole) <= {None, frame}


@pytest.mark.parametrize("seed", range(4))
def test_of_a_stream_that_loses_a_tenth_of_its_fragments_no_mixed_frame_is_assembled(seed: int):
    rng = random.Random(seed)
    sent = [observations(size=rng.randrange(30, 714), time_ms=n, seed=seed) for n in range(150)]
    assembly = Assembly()

    whole: list[bytes] = []
    time_s = 0.0
    for sequence, frame in enumerate(sent):
        for fragment in fragments_of(frame, sequence):
            time_s += 0.02
            if rng.random() < 0.1:
                continue
            taken = assembly.take(fragment.flags, fragment.data, time_s)
            if taken is not None:
                whole.append(taken)

    assert set(whole) <= set(sent)
    assert len(whole) > 0.6 * len(sent)


def test_fragments_of_another_round_of_the_count_are_not_mixed_in():
    """All 31 frames between two of one number are lost."""
    first = [*fragments_of(observations(size=500, time_ms=1), 5)]
    second = [*fragments_of(observations(size=500, time_ms=2), 5 + 32)]
    assembly = Assembly()
    assembly.take(first[0].flags, first[0].data, 0.0)
    late = [assembly.take(one.flags, one.data, 1.5) for one in second[1:]]
    assert late == [None, None]

    # within a second the checksum is what tells
    receiver = SatelliteReceiver()
    mixed: list[Fragment] = [first[0], *second[1:]]
    for fragment in mixed:
        receiver.hear(fragment.flags, fragment.data, 0.1)
    assert (receiver.frames, receiver.bad_frames) == (0, 1)
