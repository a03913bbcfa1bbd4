"""An agent that reads the mocap itself: its poses keep it flying, and say nothing of whether the
bus is there.
"""

from __future__ import annotations

import msgspec
import pytest

from onboard import agent_inputs
from onboard.agent.core import AgentCore
from onboard.config.fleet import MocapConfig
from onboard.supervision.condition_table import BUS_LOST_S
from tests.onboard.agent.rig import Rig, fleet

_DIRECT = MocapConfig(source="motioncapture", type="mock", direct=True)


@pytest.mark.parametrize(("mocap", "state"), [(_DIRECT, "holding"), (MocapConfig(), "flying")])
def test_only_poses_that_come_over_the_bus_show_that_the_bus_is_there(
    mocap: MocapConfig, state: str
) -> None:
    rig = Rig(core=AgentCore(msgspec.structs.replace(fleet(), mocap=mocap), "mav0", boot_id=7))
    rig.fly()
    # a stranger was heard just now, and nobody from here on
    rig.core.neighbours.last_heard_ns = rig.now_ns
    rig.core.handle(agent_inputs.NodeChanged("ground-1", False), rig.now_ns)
    rig.run(BUS_LOST_S + 0.5)
    assert rig.core.flight.state == state


def test_why_the_mocap_gives_nothing_reaches_people() -> None:
    rig = Rig()
    rig.core.handle(
        agent_inputs.MocapProblemChanged("vicon at 10.0.0.2 did not send more for 2 s."), rig.now_ns
    )
    rig.run(0.1)
    (event,) = [event for event in rig.events if event.code == "mocap-source"]
    assert event.sentence.startswith("vicon at 10.0.0.2")
