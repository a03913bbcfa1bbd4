"""A vehicle that the fleet file disables: nobody waits for it, all avoid it once it is heard, it
does not arm.
"""

from __future__ import annotations

import msgspec

from onboard import agent_commands, agent_inputs
from onboard.agent.core import AgentCore
from onboard.bus.schema import StateMessage
from onboard.config.fleet import FleetConfig
from onboard.neighbours.table import NeighbourTable
from tests.onboard.agent.rig import Rig, fleet
from tests.onboard.state_messages import state_message

S = 1_000_000_000


def _fleet(enabled: object = True) -> FleetConfig:
    whole = fleet(("mav0", "mav1", "mav2"), enabled=enabled)
    return msgspec.structs.replace(
        whole,
        vehicles={
            **whole.vehicles,
            "mav1": msgspec.structs.replace(whole.vehicles["mav1"], enabled=False),
        },
    )


def _state(stamp_ns: int, sequence: int = 1) -> StateMessage:
    return state_message(stamp_ns=stamp_ns, sequence=sequence, position_enu_m=(0.9, 0.0, 1.0))


def test_nobody_waits_for_a_disabled_vehicle() -> None:
    table = NeighbourTable(_fleet(), "mav0")
    table.bodies_to_watch(1 * S, 0.02)
    assert table.bodies_to_watch(9 * S, 0.02) == ("mav2",)
    assert table.missing(9 * S) == ("mav2",)
    assert table.silent(9 * S) == table.invalid() == table.unseen(9 * S) == ()
    assert not table.snapshot(9 * S)


def test_a_disabled_vehicle_that_tells_a_state_is_an_obstacle_and_missed_when_it_falls_silent() -> (
    None
):
    table = NeighbourTable(_fleet(), "mav0")
    assert table.hear(_state(5 * S), 5 * S)
    (neighbour,) = table.snapshot(5 * S)
    assert neighbour.position_enu_m == (0.9, 0.0, 1.0)
    assert table.distances_m((0.0, 0.0, 1.0), 5 * S) == {"mav1": 0.9}
    assert table.silent(6 * S) == ("mav1",)
    assert "mav1" in (table.bodies_to_watch(6 * S, 0.02) or ())


def test_the_law_goes_aside_for_a_disabled_vehicle() -> None:
    rig = Rig(AgentCore(_fleet("scan"), "mav0", boot_id=7))

    def tell() -> None:
        rig.core.handle(
            agent_inputs.NeighbourReceived(_state(rig.now_ns, rig.tick_count), rig.now_ns),
            rig.now_ns,
        )

    rig.fly()
    rig.after_move = tell
    rig.run(0.5)
    rig.order("move", position_enu_m=(0.9, 0.0, 1.0))
    nearest_m = 9.0
    for _ in range(200):
        rig.step()
        nearest_m = min(nearest_m, float(((rig.position[:2] - (0.9, 0.0)) ** 2).sum()) ** 0.5)
    assert nearest_m > 0.8


def test_a_disabled_vehicle_refuses_to_arm_and_says_why() -> None:
    rig = Rig(AgentCore(_fleet("scan"), "mav1", boot_id=7))
    rig.run(3.0)
    assert rig.core.flight.state == "waiting"
    for kind in ("arm", "takeoff"):
        reply = rig.order(kind)
        assert not reply.is_accepted
    assert any("disables this vehicle" in reason for reason in rig.core.preflight.not_ready)
    assert rig.count(agent_commands.Arm) == rig.count(agent_commands.SetOffboard) == 0
