"""What a user's own law is given, which of its answers can be flown, and how long it may take."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from onboard.avoidance import oist, own_law
from onboard.avoidance.interface import NOBODY, Baseline
from onboard.avoidance.own_law import LawInputs
from onboard.avoidance.own_law_runner import OwnLawRunner
from onboard.config.fleet import OwnLaw
from onboard.constants import GRAVITY_M_S2
from onboard.types import LawOutput, LawStatus, Neighbour, Thrust
from onboard.vectors import ZERO_3, Vec3
from tests.onboard.avoidance.law_cases import law_of, neighbour_of, state_of, thrust_of

_PARAMS = law_of({"max_tilt_rad": math.radians(25.0), "max_thrust_m_s2": 2.0 * GRAVITY_M_S2})
_STATE = state_of((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
_MEMORY = oist.initial()
_PREDICTED = oist.predict(_MEMORY, _STATE, _PARAMS, 0.02)
_HOVERS = Baseline(thrust_of((0.0, 0.0, 0.0)), ZERO_3, ZERO_3)
_DT_S = 0.02


def _inputs(baseline: Baseline = _HOVERS, neighbours: tuple[Neighbour, ...] = ()) -> LawInputs:
    """The inputs of a vehicle that hovers a metre above the origin."""
    tick = _covey_tick(baseline, neighbours)
    return own_law.law_inputs(
        tick.own, tick.neighbours, baseline, _PREDICTED, _STATE, neighbours, (), _PARAMS, _DT_S
    )


def _covey_tick(
    baseline: Baseline = _HOVERS, neighbours: tuple[Neighbour, ...] = ()
) -> own_law.CoveyTick:
    return own_law.covey_tick(
        _MEMORY, 0.0, baseline, _PREDICTED, _STATE, neighbours, (), _PARAMS, _DT_S
    )


def _tilted(degrees: float, up_m_s2: float = GRAVITY_M_S2) -> Vec3:
    return Vec3(0.0, up_m_s2 * math.tan(math.radians(degrees)), up_m_s2)


def test_a_law_is_given_the_neighbours_in_range_the_nearest_first() -> None:
    far = neighbour_of((2.0, 0.0, 1.0), table_index=4)
    near = neighbour_of((0.0, 1.0, 1.0), (0.0, -0.5, 0.0), table_index=7, is_cooperative=False)
    beyond = neighbour_of((99.0, 0.0, 1.0), table_index=1)
    inputs = _inputs(neighbours=(far, near, beyond))

    assert [one.table_index for one in inputs.neighbours] == [7, 4]
    first = inputs.neighbours[0]
    assert first.w_m_s == pytest.approx((0.0, 0.5))
    assert (first.e_m.x, first.is_cooperative) == (0.0, False)
    assert first.d_m > inputs.neighbours[1].d_m  # it avoids nobody, and gets more room
    assert inputs.received == (far, near, beyond)
    assert [inputs.heard(one) for one in inputs.neighbours] == [near, far]


def test_a_law_is_given_the_right_one_of_two_entries_of_a_neighbour() -> None:
    said = neighbour_of((2.0, 0.0, 1.0), table_index=4)
    seen = neighbour_of((-1.5, 0.0, 1.0), table_index=4, is_cooperative=False)
    inputs = _inputs(neighbours=(said, seen))
    assert [inputs.heard(one) for one in inputs.neighbours] == [seen, said]


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ((None, (0.0, 0.0, 9.81)), ""),
        ([None, (0.0, 0.0, 9.81)], "returned a list instead of the pair"),
        ((None,), "returned a tuple instead of the pair"),
        ((None, (0.0, 0.0, 9.81), None), "returned a tuple instead of the pair"),
        (None, "returned nothing instead of the pair"),
        ((None, None), "returned nothing instead of a thrust"),
        ((None, "123"), "returned a str instead of a thrust"),
        ((None, (0.0, 9.81)), "returned a tuple instead of a thrust of three numbers (it has 2)"),
        ((None, ("a", "b", "c")), "returned a tuple instead of a thrust of three numbers"),
        ((None, ("0", "0", "9.81")), "returned a tuple instead of a thrust of three numbers"),
        ((None, np.array([0j, 1j, 9.81])), "returned a ndarray instead of a thrust of three"),
        ((None, np.array([0, 0, 10], np.float32)), ""),
        ((None, np.array([0, 0, 10])), ""),
        ((None, (0.0, math.nan, 9.81)), "not finite: (0, nan, 9.81)"),
    ],
)
def test_an_answer_is_a_memory_and_a_thrust_of_three_finite_numbers(
    answer: Any, words: str
) -> None:
    _, _, refusal = own_law.judged(answer, _inputs())
    assert words in refusal
    assert bool(words) is bool(refusal)
    assert "(it has 3)" not in refusal


@pytest.mark.parametrize(
    ("thrust", "words"),
    [
        (Vec3(0.0, 0.0, 0.5 * GRAVITY_M_S2), ""),
        (Vec3(0.0, 0.0, 0.499 * GRAVITY_M_S2), "a vertical thrust of 4.89 m/s^2"),
        (Vec3(0.0, 0.0, 2.0 * GRAVITY_M_S2), ""),
        (Vec3(0.0, 0.0, 2.001 * GRAVITY_M_S2), "a vehicle flies with 4.9 to 19.6 m/s^2"),
        (_tilted(25.99), ""),
        (_tilted(26.01), "tilted by 26 degrees, and max_tilt_deg is 25"),
        (_tilted(19.0, 1.9 * GRAVITY_M_S2), ""),
        (_tilted(20.0, 1.9 * GRAVITY_M_S2), "and the motors give 19.6"),
    ],
)
def test_a_thrust_keeps_the_vehicle_up_and_the_limits_of_tilt_and_motors(
    thrust: Vec3, words: str
) -> None:
    memory, flown, refusal = own_law.judged(("memory", thrust), _inputs())
    assert (memory, flown) == ("memory", thrust)
    assert words in refusal
    assert bool(words) is bool(refusal)


def test_the_compensation_counts_for_the_tilt() -> None:
    thrust = _tilted(20.0)
    with_wind = _HOVERS._replace(compensation_enu_m_s2=Vec3(0.0, 1.5, 0.0))
    assert own_law.judged((None, thrust), _inputs())[2] == ""
    assert "tilted by 27 degrees" in own_law.judged((None, thrust), _inputs(with_wind))[2]


@pytest.mark.parametrize(
    ("change_m_s2", "status"),
    [(0.0, LawStatus.INACTIVE), (0.9e-9, LawStatus.INACTIVE), (1.2e-9, LawStatus.SATURATED)],
)
def test_what_is_flown_in_coveys_place_is_told_as_its_own(
    change_m_s2: float, status: LawStatus
) -> None:
    tick = _covey_tick()
    squeezed = tick.output._replace(slack_m_s2=2.0, active_neighbour=3)
    thrust = Vec3(change_m_s2, 0.0, GRAVITY_M_S2)
    memory, output = own_law.flown_instead(thrust, tick.own, squeezed, tick.memory, _MEMORY, _DT_S)
    assert output.status == status
    assert output.intervention_m_s2 == pytest.approx(change_m_s2)
    assert (output.slack_m_s2, output.active_neighbour) == (0.0, NOBODY)
    assert output.thrust == Thrust(thrust)
    assert memory.commands[0].acceleration_enu_m_s2 == Vec3(change_m_s2, 0.0, 0.0)


# -- the runner ------------------------------------------------------------------------------------

_Law = Callable[[Any, LawInputs], Any]


class _Flown:
    """A flight with a law that returns the baseline, and takes as long as its test says."""

    def __init__(self, law: _Law | None = None) -> None:
        self.now_s = 7.0
        self.takes_s = 0.0
        self.runner = OwnLawRunner(
            OwnLaw("mine:law", "mine.py", "0", lambda: law or self._law), lambda: self.now_s
        )

    def _law(self, memory: Any, inputs: LawInputs) -> Any:
        self.now_s += self.takes_s
        return memory, inputs.baseline

    def tick(self, takes_s: float = 0.0, baseline: Baseline = _HOVERS) -> LawOutput:
        """Fly one tick of the law."""
        self.takes_s = takes_s
        return self.runner.step(_MEMORY, baseline, _PREDICTED, _STATE, (), (), _PARAMS, _DT_S)[1]


@pytest.mark.parametrize(
    ("took_ms", "refusal"),
    [
        ((6.0, 6.0, 4.9, 6.0, 6.0, 4.9), ""),
        ((6.0, 6.0, 6.0), "took 6 ms in 3 ticks in a row, and may take 5 ms of a tick"),
        ((4.9, 4.9, 4.9, 4.9), ""),
        ((99.0,), ""),
        ((101.0,), "took 101 ms, and may take 5 ms of a tick"),
    ],
)
def test_a_law_is_slow_in_three_ticks_in_a_row_or_in_a_very_long_one(
    took_ms: tuple[float, ...], refusal: str
) -> None:
    flown = _Flown()
    for ms in took_ms:
        assert flown.runner.refusal == ""
        flown.tick(1e-3 * ms)
    assert flown.runner.refusal == refusal


def test_a_new_flight_forgets_slow_ticks_and_the_laws_memory() -> None:
    seen: list[Any] = []

    def counting(memory: Any, inputs: LawInputs) -> Any:
        seen.append(memory)
        return len(seen), inputs.baseline

    flown = _Flown(counting)
    flown.tick()
    flown.tick()
    flown.runner.begin_anew()
    flown.tick()
    assert seen == [None, 1, None]

    slow = _Flown()
    for _ in range(2):
        slow.tick(0.006)
        slow.tick(0.006)
        assert slow.runner.refusal == ""
        slow.runner.begin_anew()


def test_where_time_is_simulated_no_law_is_slow() -> None:
    law = OwnLaw("mine:law", "mine.py", "0", lambda: lambda memory, inputs: (None, inputs.baseline))
    runner = OwnLawRunner(law)
    runner.step(_MEMORY, _HOVERS, _PREDICTED, _STATE, (), (), _PARAMS, _DT_S)
    assert runner.refusal == ""


def test_a_refusal_is_not_replaced_by_slowness() -> None:
    def wrong(memory: Any, inputs: LawInputs) -> Any:
        flown.now_s += 1.0

    flown = _Flown(wrong)
    flown.tick()
    assert flown.runner.refusal == "returned nothing instead of the pair (memory, thrust)"


def test_inputs_that_cannot_be_used_are_no_laws_fault() -> None:
    calls: list[int] = []

    def noting(memory: Any, inputs: LawInputs) -> Any:
        calls.append(1)
        return None, inputs.baseline

    flown = _Flown(noting)
    unusable = _HOVERS._replace(thrust=Thrust(Vec3(math.nan, 0.0, GRAVITY_M_S2)))
    assert flown.tick(baseline=unusable).status == LawStatus.INFEASIBLE
    assert (calls, flown.runner.refusal) == ([], "")
    flown.tick()
    assert calls == [1]


def test_a_jam_of_coveys_law_slows_a_vehicle_down_only_when_it_flies() -> None:
    squeezed = [
        neighbour_of((0.3 * x, 0.3 * y, 1.0), is_cooperative=False, table_index=k)
        for k, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1)))
    ]
    fails = False

    def law(memory: Any, inputs: LawInputs) -> Any:
        return None if fails else (None, inputs.baseline)

    runner = _Flown(law).runner

    def relaxed_share() -> float:
        after, _ = runner.step(_MEMORY, _HOVERS, _PREDICTED, _STATE, squeezed, (), _PARAMS, _DT_S)
        return after.relaxed_share

    assert [relaxed_share(), relaxed_share()] == [0.0, 0.0]
    fails = True
    assert relaxed_share() == pytest.approx(1.0 - 0.93**3)

    runner.begin_anew()
    assert relaxed_share() == pytest.approx(0.07)


def test_the_message_of_an_exception_is_cut_off() -> None:
    def failing(memory: Any, inputs: LawInputs) -> Any:
        raise ValueError("m" * 200)

    flown = _Flown(failing)
    flown.tick()
    assert flown.runner.refusal == "raised ValueError: " + "m" * 120
