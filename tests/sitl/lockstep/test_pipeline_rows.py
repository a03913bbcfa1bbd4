"""An agent's compiled pass keeps rows between ticks; it returns what a pass without a past does."""

from __future__ import annotations

import pytest

from onboard.config.fleet import load_fleet
from onboard.control import pipeline
from onboard.control.control_mode import ControlMode
from onboard.neighbours.state_arrays import SCALAR_COLUMN
from onboard.neighbours.table import NeighbourTable
from onboard.rollout import layouts, loops
from onboard.rollout.rows import floats
from onboard.types import Goal, Neighbour, State, Tick
from onboard.vectors import ZERO_3, Vec3
from sitl.lockstep.pipeline_rows import CompiledPipeline
from tests.onboard.agent.rig import fleet
from tests.onboard.state_messages import state_message

HERE = Vec3(0.0, 0.0, 1.0)
NOW_NS = 1_000_000_000
PERIODS_NS = (20_000_000, 20_000_000)  # two agents tick together: their passes are compiled
PARAMS = pipeline.pipeline_params(load_fleet("configs/fleets/paper.toml"), "mav0")


def neighbour(east_m: float, age_s: float, index: int) -> Neighbour:
    position = Vec3(east_m, 0.2, 1.0)
    towards = Vec3(-0.4, 0.0, 0.0)
    return Neighbour(
        position_enu_m=position,
        velocity_enu_m_s=towards,
        acceleration_enu_m_s2=ZERO_3,
        predicted_position_enu_m=position,
        predicted_velocity_enu_m_s=towards,
        commanded_acceleration_enu_m_s2=ZERO_3,
        intent_enu_m_s=towards,
        age_s=age_s,
        lead_time_s=0.15,
        position_std_m=0.003,
        velocity_std_m_s=0.02,
        crowd_count=1.0,
        is_cooperative=True,
        is_paper_obstacle=False,
        table_index=index,
        radius_m=0.0,
    )


# what changes from tick to tick: the message of one, only ages, who is there, and nobody
SEEN: tuple[list[Neighbour], ...] = (
    [neighbour(1.2, 0.0, 0), neighbour(-1.6, 0.02, 1)],
    [neighbour(1.1, 0.0, 0), neighbour(-1.6, 0.04, 1)],
    [neighbour(1.1, 0.02, 0), neighbour(-1.6, 0.06, 1)],
    [neighbour(-1.6, 0.08, 1), neighbour(1.1, 0.04, 0)],
    [neighbour(1.05, 0.0, 0)],
    [],
    [neighbour(1.0, 0.0, 0), neighbour(-1.5, 0.0, 1)],
)


def flown(*, has_past: bool) -> list[Tick]:
    state = State(
        position_enu_m=HERE,
        velocity_enu_m_s=ZERO_3,
        acceleration_enu_m_s2=ZERO_3,
        yaw_rad=0.0,
        age_s=0.0,
        position_std_m=0.003,
        velocity_std_m_s=0.02,
    )
    goal = Goal(Vec3(2.0, 0.0, 1.0), 0.0, 1)
    memory = pipeline.initial(PARAMS, HERE)
    compiled = CompiledPipeline()

    ticks = []
    for neighbours in SEEN:
        if not has_past:
            compiled = CompiledPipeline()
        compiled.begin_tick(PERIODS_NS)
        memory, tick = compiled.step(
            memory, state, goal, neighbours, (), ControlMode.FLYING, PARAMS, 0.02
        )
        ticks.append(tick)
    return ticks


@pytest.mark.skipif(not loops.is_compiled(), reason="nothing is compiled without numba")
def test_rows_that_are_kept_hold_the_neighbours_of_this_tick() -> None:
    kept = flown(has_past=True)
    assert kept == flown(has_past=False)
    assert len({tick.law for tick in kept}) == len(SEEN), "each change matters to the law"


def test_a_snapshot_is_the_rows_of_its_neighbours() -> None:
    table = NeighbourTable(fleet(("mav0", "mav1", "mav2")), "mav0")
    table.hear(state_message(vehicle="mav2", crowd_count=3.0, lead_time_s=0.2), NOW_NS)
    assert len(table.snapshot(NOW_NS)) == 1
    table.hear(state_message(vehicle="mav1", is_cooperative=False), NOW_NS)

    seen = table.snapshot(NOW_NS + PERIODS_NS[0])
    packed = floats(layouts.NEIGHBOUR.packed(list(seen)))
    assert (packed == seen.rows).all()
    indices = packed[:, SCALAR_COLUMN["table_index"]].tolist()
    assert indices == [0.0, 1.0], "the indices tell them apart"
