"""Times in which nobody saw how far two vehicles were from each other."""

from __future__ import annotations

from typing import Any

import pytest

from groundstation.fleet.state import FleetState, fold, fold_batch, initial, unknown_until
from groundstation.fleet.unknown_time import MAX_KEPT
from onboard.bus.schema import Truth
from onboard.config.fleet import FleetConfig

MS = 1_000_000
SECOND = 1_000 * MS


def truth(name: str, x: float, stamp_ns: int) -> Truth:
    """Return a sample of ground truth in the air."""
    return Truth(
        vehicle=name,
        stamp_ns=stamp_ns,
        position_enu_m=(x, 0.0, 1.0),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
        is_on_ground=False,
        is_collided=False,
    )


class Heard:
    """Telemetry of two vehicles, 10 Hz, that fly at fixed places."""

    def __init__(self, fleet: FleetConfig, make_telemetry: Any) -> None:
        self.state: FleetState = initial(fleet)
        self._make = make_telemetry
        self._sequence = 0

    def hear(self, name: str, x: float, at_s: float, **fields: Any) -> None:
        """Fold one telemetry message."""
        self._sequence += 1
        fields = {"is_airborne": True, "is_armed": True, **fields}
        message = self._make(name, sequence=self._sequence, position_enu_m=(x, 0.0, 1.0), **fields)
        self.state = fold(self.state, message, round(at_s * SECOND))


@pytest.fixture
def heard(fleet: FleetConfig, make_telemetry: Any) -> Heard:
    """Return a ground that hears what a test says."""
    return Heard(fleet, make_telemetry)


@pytest.mark.parametrize(("silence_s", "is_unknown"), [(0.4, False), (0.5, False), (0.6, True)])
def test_a_vehicle_that_is_silent_for_longer_than_half_a_second_is_not_seen(
    heard: Heard, silence_s: float, is_unknown: bool
) -> None:
    heard.hear("mav0", 0.0, 10.0)
    heard.hear("mav1", 3.0, 10.0 + silence_s)
    heard.hear("mav0", 0.0, 10.0 + silence_s)
    assert bool(heard.state.unknown_times) is is_unknown


def test_the_bound_is_what_both_can_fly_in_the_time(heard: Heard) -> None:
    heard.hear("mav0", 0.0, 10.0)
    heard.hear("mav1", 3.0, 11.0)
    heard.hear("mav0", 0.0, 11.0)

    (time,) = heard.state.unknown_times
    assert (time.vehicle, time.other) == ("mav0", "mav1")
    assert time.duration_s == pytest.approx(1.0)
    assert time.possible_m == pytest.approx(3.0 - heard.state.top_speed_m_s * 1.0)


def test_two_that_were_both_silent_may_have_come_twice_as_near(heard: Heard) -> None:
    heard.hear("mav0", 0.0, 10.0)
    heard.hear("mav1", 5.0, 10.0)
    (time, _) = unknown_until(heard.state, 11 * SECOND)
    assert time.possible_m == pytest.approx(5.0 - 2.0 * heard.state.top_speed_m_s * 1.0)


def test_many_harmless_silences_hide_no_dangerous_one(heard: Heard) -> None:
    for second in range(10, 10 + 2 * MAX_KEPT, 1):
        heard.hear("mav1", 50.0, float(second))
        heard.hear("mav0", 0.0, float(second))
    heard.hear("mav1", 1.5, 10.0 + 2 * MAX_KEPT)
    heard.hear("mav0", 0.0, 10.0 + 2 * MAX_KEPT)

    times = heard.state.unknown_times
    assert len(times) == MAX_KEPT
    assert min(time.possible_m for time in times) < 1.5


def test_whoever_stands_disarmed_is_where_it_was(heard: Heard) -> None:
    heard.hear("mav0", 0.0, 10.0, is_airborne=False, is_armed=False)
    for tick in range(100):
        heard.hear("mav1", 3.0 - 0.03 * tick, 10.0 + 0.1 * tick)

    assert unknown_until(heard.state, 20 * SECOND) == ()
    # and who flies past it is compared with it
    assert heard.state.smallest is not None
    assert heard.state.smallest.distance_m == pytest.approx(0.03, abs=1e-6)


def test_a_position_that_is_not_valid_is_no_sight(heard: Heard) -> None:
    heard.hear("mav0", 0.0, 10.0)
    for tick in range(20):
        heard.hear("mav1", 3.0, 10.0 + 0.1 * tick)
        heard.hear("mav0", 0.0, 10.0 + 0.1 * tick, is_position_valid=tick == 0)
    (time,) = unknown_until(heard.state, 12 * SECOND)
    assert time.vehicle == "mav0"
    assert time.duration_s == pytest.approx(2.0)


def test_truth_that_waited_while_the_ground_stood_leaves_nothing_unknown(
    fleet: FleetConfig, make_telemetry: Any
) -> None:
    """The samples come in one batch, 25 s later; between them is what really happened."""
    state = initial(fleet)
    state = fold_batch(state, [(truth("mav0", 0.0, 0), 0), (truth("mav1", 3.0, 0), 0)], 0)

    late = []
    for tick in range(1, 26):
        near_m = 0.6 if tick == 12 else 3.0
        late.append((truth("mav0", 0.0, tick * 400 * MS), 0))
        late.append((truth("mav1", near_m, tick * 400 * MS), 0))
    late.append((make_telemetry("mav0", is_airborne=True), 0))
    state = fold_batch(state, late, 10 * SECOND)

    assert state.unknown_times == ()
    assert state.smallest_truth is not None
    assert state.smallest_truth.distance_m == pytest.approx(0.6)


def test_truth_that_is_missing_in_between_does_not(fleet: FleetConfig) -> None:
    state = initial(fleet)
    for at_s in (0, 25):
        stamp_ns = at_s * SECOND
        batch = [(truth("mav0", 0.0, stamp_ns), 0), (truth("mav1", 3.0, stamp_ns), 0)]
        state = fold_batch(state, batch, stamp_ns)
    assert [time.possible_m for time in state.unknown_times] == [0.0, 0.0]


def test_where_truth_ends_telemetry_goes_on(heard: Heard) -> None:
    """The smallest distance is that of the telemetry, which came after the last truth."""
    samples = [(truth("mav0", 0.0, 0), 0), (truth("mav1", 1.0, 0), 0), (truth("mav2", 9.0, 0), 0)]
    heard.state = fold_batch(heard.state, samples, 0)
    for tick in range(20):
        heard.hear("mav0", 0.0, 0.1 * tick)
        heard.hear("mav1", 1.0 - 0.015 * tick, 0.1 * tick)

    known = heard.state.smallest_known
    assert known is not None
    assert not known.is_truth
    assert known.distance_m == pytest.approx(0.715, abs=0.02)


def test_truth_of_one_and_telemetry_of_the_other_give_their_distance(heard: Heard) -> None:
    heard.hear("mav0", 0.0, 0.0)
    heard.state = fold_batch(heard.state, [(truth("mav1", 3.0, 0), 0)], 0)
    for tick in range(1, 21):
        now_ns = tick * 100 * MS
        sample = truth("mav0", 0.0, now_ns)  # the agent of mav0 is dead
        heard.state = fold_batch(heard.state, [(sample, now_ns)], now_ns)
        heard.hear("mav1", 3.0 - 0.1 * tick, 0.1 * tick)

    known = heard.state.smallest_known
    assert known is not None
    assert known.distance_m == pytest.approx(1.0, abs=0.02)
    assert unknown_until(heard.state, 2 * SECOND) == ()
