"""Two agents for one vehicle: whoever hears both says so, the two learn of it, neither flies."""

from __future__ import annotations

import pickle

import msgspec

from onboard import agent_commands, agent_inputs
from onboard.agent.core import AgentCore
from onboard.bus.schema import Telemetry
from onboard.neighbours.duplicate_agents import DuplicateAgents
from tests.onboard.agent.rig import Rig, fleet, hovering_rig

S = 1_000_000_000


def told(rig: Rig) -> Telemetry:
    assert rig.telemetry is not None
    return rig.telemetry


def other(boot_id: int) -> Rig:
    rig = Rig(core=AgentCore(fleet(), "mav1", boot_id=boot_id))
    rig.run(1.0)
    return rig


def hear(rig: Rig, message: Telemetry) -> None:
    rig.core.handle(agent_inputs.NeighbourReceived(message, rig.now_ns), rig.now_ns)


def test_a_restart_is_one_agent_after_the_other_and_an_earlier_one_that_comes_back_makes_two() -> (
    None
):
    duplicates = DuplicateAgents()
    for boot_id in (1, 1, 2, 2, 3, 3):
        duplicates.hear("mav1", boot_id, 5 * S)
    assert duplicates.names(5 * S) == ()
    duplicates.hear("mav1", 2, 6 * S)
    assert duplicates.names(6 * S) == ("mav1",)
    duplicates.hear("mav1", 3, 7 * S)
    assert duplicates.names(8 * S) == ("mav1",)
    assert duplicates.names(10 * S) == ()


def test_a_thousand_boot_ids_are_not_kept() -> None:
    duplicates = DuplicateAgents()
    for boot_id in range(1000):
        duplicates.hear("mav1", boot_id, S)
    assert len(pickle.dumps(duplicates)) < 1000
    duplicates.hear("mav1", 0, S)  # long forgotten, so it counts as new
    assert duplicates.names(S) == ()


def test_a_third_agent_that_hears_both_tells_them() -> None:
    third = Rig()
    first = other(11)
    second = other(22)
    for _ in range(3):
        hear(third, told(first))
        hear(third, told(second))
    third.run(0.2)
    assert told(third).doubles == ("mav1",)
    for twin in (first, second):  # which do not hear each other
        hear(twin, told(third))
        twin.run(0.2)
        assert any("nother agent" in reason for reason in told(twin).not_ready)
        reply = twin.order("takeoff", height_m=1.0)
        assert not reply.is_accepted


def test_an_agent_flies_on_when_a_second_one_appears_and_the_second_one_sends_nothing() -> None:
    rig = hovering_rig()
    begin_ns = rig.now_ns
    for _ in range(20):
        hear(rig, msgspec.structs.replace(told(rig), boot_id=99))
        rig.run(0.1)
    assert rig.core.flight.state in ("flying", "holding")
    assert rig.count(agent_commands.SendAttitude, begin_ns) == 100
    assert any(event.code == "twin" for event in rig.events)
    newcomer = Rig(position=rig.position.copy(), is_armed=True, mode="OFFBOARD")
    newcomer.has_flown = True
    newcomer.run(0.5)
    assert (
        newcomer.count(agent_commands.SendAttitude)
        == newcomer.count(agent_commands.SetOffboard)
        == newcomer.count(agent_commands.Px4Land)
        == 0
    )
