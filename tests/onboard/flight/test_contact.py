"""Contact with the ground: no single signal ends the thrust, contact is taken back, and any height
is ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from onboard import agent_commands
from onboard.agent.core import AgentCore
from onboard.autopilot import Landed
from onboard.flight.types import FlightStep
from onboard.frames import body_up
from tests.onboard.agent.rig import Rig, fleet, ready_rig


def _hover(height_m: float) -> Rig:
    rig = ready_rig()
    rig.order("takeoff", height_m=height_m)
    rig.until("flying")
    return rig


def _sink(rig: Rig, until: Callable[[], bool], timeout_s: float = 20.0) -> float:
    """Return the largest speed downwards [m/s] until a condition holds."""
    fastest = 0.0
    for _ in range(round(timeout_s / 0.02)):
        if until():
            return fastest
        rig.step()
        fastest = max(fastest, -float(rig.velocity[2]))
    raise AssertionError(f"still {rig.core.flight.step.name} at {rig.position[2]:.2f} m")


@pytest.mark.parametrize("seconds", [0.06, 0.5, math.inf])
def test_a_wrong_report_of_the_ground_in_a_landing_does_not_end_the_thrust(seconds: float) -> None:
    rig = _hover(1.8)
    rig.order("land", order_id="land")
    rig.run(1.2)
    assert rig.position[2] > 1.2
    end_ns = rig.now_ns + seconds * 1e9

    def report() -> None:
        rig.landed_report = Landed.ON_GROUND if rig.now_ns < end_ns else None

    rig.after_move = report
    assert _sink(rig, lambda: rig.position[2] <= 0.0) < 1.0
    rig.until("landed")
    assert rig.outcomes()["land"] == "done"


def test_reports_of_the_ground_that_stopped_at_the_take_off_do_not_count() -> None:
    rig = ready_rig()
    rig.order("takeoff", height_m=1.8)
    while rig.core.flight.step is not FlightStep.LIFTOFF:
        rig.step()
    rig.has_landed_reports = False
    rig.until("flying")
    rig.order("land", order_id="land")
    assert _sink(rig, lambda: rig.position[2] <= 0.0) < 1.0
    rig.until("landed")
    assert rig.outcomes()["land"] == "done"


def test_a_landing_ends_on_ground_that_reads_lower_than_that_of_the_take_off() -> None:
    rig = _hover(1.8)
    rig.order("land", order_id="land")
    _sink(rig, lambda: rig.core.flight.step is FlightStep.CONTACT)
    rig.floor_m = -0.6  # a height by satellites that was too low: it seemed to stand, and falls
    rig.until("landed")
    assert rig.outcomes()["land"] == "done"


@pytest.mark.parametrize("floor_m", [1.0, 0.0], ids=["on-the-roof", "in-the-yard"])
def test_beside_its_spot_on_a_roof_it_lands_on_what_is_there(floor_m: float) -> None:
    config = fleet()
    on_roof = replace(config.vehicles["mav0"], start_enu_m=(0.0, 0.0, 1.0))
    roof = replace(config, vehicles={**config.vehicles, "mav0": on_roof})
    core = AgentCore(roof, "mav0", boot_id=7)
    rig = Rig(core=core, floor_m=1.0, position=np.array([0.0, 0.0, 1.0]))
    rig.until("ready")
    rig.order("takeoff", height_m=2.0)
    rig.until("flying")
    rig.order("move", position_enu_m=(1.5, -1.5, 2.0), order_id="aside")
    while "aside" not in rig.outcomes():
        rig.step()

    rig.floor_m = floor_m
    rig.order("land", order_id="land")
    assert _sink(rig, lambda: rig.position[2] <= floor_m) < 1.0
    rig.until("landed")
    assert rig.outcomes()["land"] == "done"
    assert rig.count(agent_commands.Px4Land) == 0


def test_contact_is_taken_back_when_the_vehicle_falls() -> None:
    rig = _hover(2.2)
    rig.floor_m = 1.8
    rig.order("land", order_id="land")
    _sink(rig, lambda: rig.core.flight.step is FlightStep.CONTACT)
    rig.floor_m = 0.0  # what it stood on gives way
    assert _sink(rig, lambda: rig.position[2] <= 0.0) < 2.5  # a free fall ends at 5.9 m/s
    assert -rig.core.own.velocity_enu_m_s[2] < 1.5
    rig.until("landed")
    assert rig.outcomes()["land"] == "done"


@pytest.mark.parametrize("floor_m", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("push_m_s2", [0.0, 0.8])
def test_on_ground_of_any_height_it_is_level_at_once_and_disarmed_within_three_seconds(
    floor_m: float, push_m_s2: float
) -> None:
    rig = _hover(1.0)
    rig.floor_m = floor_m

    def stand() -> None:
        if rig.position[2] <= rig.floor_m:
            rig.velocity = np.zeros(3)
        else:
            rig.velocity[0] += 0.02 * push_m_s2  # wind, against which it leans

    rig.after_move = stand
    rig.order("land", order_id="land")
    _sink(rig, lambda: rig.position[2] <= rig.floor_m)
    contact_ns = rig.now_ns
    tilts = []
    while rig.is_armed:
        rig.step()
        setpoint = rig.setpoint
        assert setpoint is not None
        tilts.append(
            (
                rig.now_ns - contact_ns,
                math.degrees(math.acos(min(1.0, body_up(setpoint.quaternion_wxyz)[2]))),
            )
        )
        limit_ns = 3_000_000_000 if rig.sees_ground else 4_200_000_000
        assert rig.now_ns - contact_ns < limit_ns, rig.core.flight.step
    late = [tilt_deg for age_ns, tilt_deg in tilts if age_ns > 600_000_000]
    assert max(late) < 0.1
    assert max(tilt_deg for _, tilt_deg in tilts) < 12.0
    rig.until("landed")
    assert rig.outcomes()["land"] == "done"
    assert rig.count(agent_commands.Px4Land) == 0


@pytest.mark.parametrize("floor_m", [-0.08, -0.3, -2.0])
def test_on_ground_lower_than_that_of_the_take_off_it_sets_down_gently(floor_m: float) -> None:
    rig = _hover(1.0)
    rig.floor_m = floor_m
    rig.order("land", order_id="land")
    fastest_m_s = _sink(rig, lambda: rig.position[2] <= rig.floor_m)
    assert fastest_m_s < 1.0
    rig.until("landed")
    assert rig.outcomes()["land"] == "done"
    assert rig.count(agent_commands.Px4Land) == 0


def test_an_order_to_land_gives_a_vehicle_that_stands_no_thrust_again() -> None:
    rig = _hover(1.0)
    rig.order("land", order_id="first")
    _sink(rig, lambda: rig.core.flight.step is FlightStep.CONTACT)
    contact_ns = rig.now_ns
    for number in range(4):
        rig.run(0.4)
        assert rig.order("land", order_id=f"again{number}").is_accepted
    rig.until("landed")

    thrusts = {
        command.setpoint.thrust_frac
        for stamp_ns, command in rig.sent
        if isinstance(command, agent_commands.SendAttitude) and stamp_ns > contact_ns
    }
    assert thrusts == {0.0}
    assert rig.now_ns - contact_ns < 5e9
    assert rig.outcomes()["again3"] == "done"


def test_an_order_to_land_again_in_the_air_does_not_put_off_the_end_of_the_landing() -> None:
    rig = _hover(1.0)
    rig.order("land")
    deadline_ns = rig.core.flight.deadline_ns
    rig.run(0.5)
    rig.order("land")
    assert rig.core.flight.step is FlightStep.DESCENT
    assert rig.core.flight.deadline_ns == deadline_ns
