"""The law against an independent transcription in numpy that tries every active set."""

import numpy as np
import pytest

from onboard.avoidance import interface, oist
from onboard.types import LawStatus
from onboard.vectors import ZERO_3
from tests.onboard.avoidance.law_cases import (
    CAPSULES,
    FENCE,
    law_of,
    random_neighbour,
    state_of,
    thrust_of,
    vec,
)
from tests.oracles import law_rows

VARIANTS = [
    {},
    {"responsibility": "full"},
    {"responsibility": "half", "rotation": "always", "direction": "fixed"},
    {"rotation": "never", "margin": "fixed"},
    {"direction": "pair", "prediction": "none"},
    {"direction": "crowd", "max_neighbours": 2, "range_m": 2.0},
]


def random_input(rng, count):
    position, velocity, intent = rng.normal(size=(3, 3)) * 0.5
    own = {
        "state": state_of(position, velocity, (abs(rng.normal()) * 0.01, abs(rng.normal()) * 0.05)),
        "accel": rng.normal(size=3) * 1.5,
        "compensation": rng.normal(size=3) * 0.3,
        "intent": intent,
        "roundabout_left_s": 1.0 if rng.random() < 0.3 else 0.0,
    }
    return own, [random_neighbour(rng, k, 1.2 + 0.1 * count) for k in range(count)]


def both(own, neighbours, capsules, params):
    """Output of the law, and the oracle's answer with the compensation taken off again."""
    memory = oist.initial()._replace(roundabout_left_s=own["roundabout_left_s"])
    predicted = oist.predict(memory, own["state"], params, 0.02)
    baseline = interface.Baseline(
        thrust_of(own["accel"]), vec(own["compensation"]), vec(own["intent"])
    )
    _, out = oist.step(
        memory, baseline, predicted, own["state"], neighbours, capsules, params, 0.02
    )
    shift = own["compensation"][:2]
    radius = interface.horizontal_limit(baseline.thrust.thrust_enu_m_s2.z, params)
    thrust = own["accel"][:2] + shift
    values = {
        "position": np.array(predicted.position_enu_m[:2]),
        "velocity": np.array(predicted.velocity_enu_m_s[:2]),
        "intent": own["intent"][:2],
        "thrust": thrust * min(1.0, radius / np.hypot(*thrust)),
        "compensation": shift,
        "radius": radius,
        "position_std": own["state"].position_std_m,
        "velocity_std": own["state"].velocity_std_m_s,
    }
    calls_for_roundabout = own["roundabout_left_s"] > 0.0
    point, *rest = law_rows.law(values, neighbours, capsules, params, calls_for_roundabout)
    return out, (point - shift, *rest)


@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_law_equals_its_transcription_in_numpy(variant):
    statuses = set()
    for count in (0, 1, 3, 6, 12):
        rng = np.random.default_rng(count)
        for is_walled in (True, False):
            params = law_of({"fence_enu_m": FENCE} if is_walled else {}, **variant)
            for case in range(5):
                own, neighbours = random_input(rng, count)
                out, (point, status, slack, crowd, active) = both(
                    own, neighbours, CAPSULES * is_walled, params
                )
                name = f"{count} neighbours, case {case}, walls {is_walled}"
                assert (out.status, out.crowd_count, out.active_neighbour) == (
                    status,
                    crowd,
                    active,
                ), name
                assert out.slack_m_s2 == pytest.approx(slack, abs=1e-7), name
                limit = (
                    1e-9 if status != LawStatus.RELAXED else 1e-3
                )  # points with nearly the least slack may lie apart
                np.testing.assert_allclose(
                    out.thrust.thrust_enu_m_s2[:2], point, atol=limit, err_msg=name
                )
                statuses.add(status)
    assert statuses == {LawStatus.INACTIVE, LawStatus.SATURATED, LawStatus.RELAXED}


def test_nothing_around_leaves_the_memory_to_the_commands():
    params = law_of()
    memory = oist.initial()
    state = state_of([0, 0, 1], [0, 0, 0])
    baseline = interface.Baseline(thrust_of([1.0, 0.5, 0.2]), ZERO_3, ZERO_3)
    after, out = oist.step(
        memory, baseline, oist.predict(memory, state, params, 0.02), state, [], (), params, 0.02
    )
    np.testing.assert_allclose(after.commands[0].acceleration_enu_m_s2, [1.0, 0.5, 0.2])
    assert after.commands[0].duration_s == 0.02
    assert after.commands[1:] == memory.commands[:-1]
    assert out.commanded_acceleration_enu_m_s2 == after.commands[0].acceleration_enu_m_s2
