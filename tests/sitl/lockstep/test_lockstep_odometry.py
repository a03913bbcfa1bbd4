"""The mocap that the agent forwards: PX4 knows its place by it, holds and lands there, and hears
nothing wrong.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from sitl.faults.catalogue import Fault
from sitl.px4.estimator import XY
from sitl.px4.estimator_errors import Source

# PX4's main and sub modes
_HOLD = (4, 3)
_LAND = (4, 6)


def _miss_m(flight, name: str) -> float:
    """Return the distance of PX4's own estimate from the truth; the mocap gives it the fleet's
    frame.
    """
    emulator = flight.simulation.emulator
    index = flight.simulation.names.index(name)
    north, east, down = emulator.estimator.local(index).position_ned_m
    truth, _, _ = emulator.world.truth_enu()
    return math.dist((east, north, -down), truth[index].tolist())


def _place(flight, name: str) -> np.ndarray:
    return np.array(flight.state.vehicles[name].truth.position_enu_m)


def _ask_px4(flight, name: str, mode: tuple[int, int]) -> None:
    """As a pilot's switch does."""
    index = flight.simulation.names.index(name)
    emulator = flight.simulation.emulator
    emulator.autopilots[index].request_mode(emulator.clock_s(index), *mode, 1)


def _resets(flight, name: str) -> int:
    return flight.agents[name].core.odometry.resets


@pytest.mark.long
def test_px4_knows_where_it_is_and_where_it_heads_by_the_forwarded_mocap(lockstep, paper):
    flight = lockstep(paper, seed=1)
    flight.takeoff(1.0)
    flight.run(2.0)
    estimator = flight.simulation.emulator.estimator
    for index, name in enumerate(flight.simulation.names):
        assert estimator.source(index) is Source.VISION
        assert _miss_m(flight, name) < 0.4  # its estimate errs by 4 to 10 cm with PX4 as it comes
        assert abs(math.degrees(estimator.yaw_error_rad[index])) < 2.0
        assert _resets(flight, name) == 0


@pytest.mark.long
def test_px4s_own_hold_and_landing_keep_the_place_with_it(lockstep, paper):
    flight = lockstep(paper, seed=2)
    flight.takeoff(1.0)
    flight.run(1.0)
    began = _place(flight, "mav1")
    _ask_px4(flight, "mav1", _HOLD)
    for _ in range(20):
        flight.run(0.5)
        assert np.linalg.norm((_place(flight, "mav1") - began)[:2]) < 0.6
    assert flight.state.vehicles["mav1"].telemetry.mode == "HOLD"
    _ask_px4(flight, "mav1", _LAND)
    assert flight.until(lambda state: not state.vehicles["mav1"].telemetry.is_armed, 30.0)
    assert np.linalg.norm((_place(flight, "mav1") - began)[:2]) < 0.6


@pytest.mark.parametrize(
    "fault",
    [
        pytest.param(Fault("mocap_frozen", "mav1", duration_s=1.0), marks=pytest.mark.long),
        Fault("mocap_jump", "mav1", duration_s=1.0, parameters={"east_m": 1.5}),
        pytest.param(
            Fault("mocap_swapped", "mav1", duration_s=1.0, parameters={"other": "mav2"}),
            marks=pytest.mark.long,
        ),
    ],
    ids=["frozen", "jump", "swapped"],
)
def test_px4_never_hears_of_a_place_that_the_agent_does_not_believe(lockstep, paper, fault):
    flight = lockstep(paper, seed=3)
    flight.takeoff(1.0)
    flight.run(1.0)
    _ask_px4(flight, "mav1", _HOLD)
    flight.run(1.0)
    flight.inject(fault)
    for _ in range(40):
        flight.run(0.05)
        # dead reckoning drifts, but nothing jumps to where it is not
        assert _miss_m(flight, "mav1") < 0.6


def test_after_a_gap_px4_is_told_to_begin_anew_and_is_back_at_once(lockstep, paper):
    flight = lockstep(paper, seed=4)
    flight.ready()
    flight.run(2.0)
    estimator = flight.simulation.emulator.estimator
    index = flight.simulation.names.index("mav1")
    jumps = int(estimator.resets[index, XY])
    flight.inject(Fault("mocap_lost", "mav1", duration_s=0.8))
    flight.run(0.7)
    assert _resets(flight, "mav1") == 0
    flight.run(0.3)
    assert _resets(flight, "mav1") == 1
    assert int(estimator.resets[index, XY]) == jumps + 1
    assert _miss_m(flight, "mav1") < 0.05
