"""A law of somebody's own flies, and whatever it does wrong, Covey's flies that tick and the rest
of the flight.
"""

import math
from dataclasses import dataclass

import pytest

from onboard.avoidance import oist
from onboard.avoidance.own_law_runner import OwnLawRunner
from onboard.config.fleet import OwnLaw
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.types import TICK_S, Goal, Thrust
from onboard.vectors import Vec3
from sitl.monte_carlo import campaign_settings
from tests.onboard.control.test_pipeline import state_of

FLEET = campaign_settings.setup_for().fleet(2)
PARAMS = pipeline.pipeline_params(FLEET, "v0")
GOAL = Goal(Vec3(1.0, 0.0, 1.0), 2.0, 1)


def alone(memory, inputs):
    return (memory or 0) + 1, inputs.baseline


def tilted(memory, inputs):
    return None, Thrust(Vec3(9.81 * math.tan(math.radians(80.0)), 0.0, 9.81))


def failing(memory, inputs):
    raise KeyError("no such thing")


def leaving(memory, inputs):
    raise SystemExit(3)


class Unspeakable(Exception):
    def __str__(self):
        raise RuntimeError


def raising(error):
    def law(memory, inputs):
        raise error

    return law


HOSTILE = {
    "raised GeneratorExit": raising(GeneratorExit()),
    "raised Unspeakable": raising(Unspeakable()),
    "raised KeyError: 'no such thing'": failing,
    "raised SystemExit: 3": leaving,
    "not finite": lambda memory, inputs: (None, (math.nan, 0.0, 9.81)),
    "tilted by 80 degrees, and max_tilt_deg is": tilted,
    "vertical thrust of 0 m/s^2, and": lambda memory, inputs: (None, (0.0, 0.0, 0.0)),
    "vertical thrust of 1e+300 m/s^2": lambda memory, inputs: (None, (0.0, 0.0, 1e300)),
    "returned nothing instead of the pair": lambda memory, inputs: None,
    "returned a Thrust instead of the pair": lambda memory, inputs: inputs.baseline,
    "returned a str instead of a thrust": lambda memory, inputs: (None, "up!"),
    "returned a list instead of a thrust of three numbers (it has 2)": lambda memory, inputs: (
        None,
        [1.0, 2.0],
    ),
    "returned nothing instead of a thrust": lambda memory, inputs: (None, None),
}


def own(function, clock=None):
    return OwnLawRunner(OwnLaw("mine:law", "mine.py", "0", lambda: function), clock)


def flown(law_step, ticks):
    """Return memory and tick after some ticks with a law in the pipeline."""
    memory = pipeline.initial(PARAMS, Vec3(0.0, 0.0, 1.0))
    state = state_of((0.0, 0.0, 1.0))
    for _ in range(ticks):
        memory, tick = pipeline.step(
            memory, state, GOAL, (), (), ControlMode.FLYING, PARAMS, TICK_S, law_step=law_step
        )
    return memory, tick


def test_a_law_that_flies_the_baseline_flies_as_coveys_does_alone_and_remembers():
    law = own(alone)
    memory, tick = flown(law.step, 5)
    expected_memory, expected = flown(oist.step, 5)
    assert law.refusal == ""
    assert tick.attitude == expected.attitude
    assert memory.law.commands == expected_memory.law.commands
    seen = []

    def remembering(memory, inputs):
        seen.append(memory)
        return alone(memory, inputs)

    law = own(remembering)
    flown(law.step, 3)
    assert seen == [None, 1, 2]


@pytest.mark.parametrize("said", HOSTILE)
def test_a_law_that_fails_is_flown_by_coveys_for_the_rest_of_the_flight(said):
    calls = []

    def late(memory, inputs):
        calls.append(1)
        return alone(memory, inputs) if len(calls) < 4 else HOSTILE[said](memory, inputs)

    law = own(late)
    memory, tick = flown(law.step, 10)
    expected_memory, expected = flown(oist.step, 10)
    assert said in law.refusal
    assert len(calls) == 4
    assert tick == expected
    assert memory == expected_memory
    law.begin_anew()
    assert law.refusal == ""  # the next flight begins with it


@dataclass
class Clock:
    now_s: float = 0.0

    def __call__(self):
        return self.now_s


@pytest.mark.parametrize(
    ("took_s", "calls", "said"),
    [
        ([0.004] * 9, 9, ""),
        ([0.02, 0.02, 0.001] * 3, 9, ""),
        (
            [0.001, 0.02, 0.02, 0.02],
            4,
            "took 20 ms in 3 ticks in a row, and may take 5 ms of a tick",
        ),
        ([0.001, 0.2], 2, "took 200 ms, and may take 5 ms of a tick"),
    ],
)
def test_a_slow_law_is_refused_by_the_clock_that_it_is_given(took_s, calls, said):
    clock = Clock()
    left = list(took_s)

    def slow(memory, inputs):
        clock.now_s += left.pop(0)
        return alone(memory, inputs)

    law = own(slow, clock)
    flown(law.step, len(took_s))
    assert law.refusal == said
    assert len(took_s) - len(left) == calls
