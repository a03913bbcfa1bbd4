"""Which nodes of the bus an agent takes for ground stations."""

from __future__ import annotations

from pathlib import Path

from onboard.agent.peers import BusNodes
from onboard.config.fleet import load_fleet

PAPER = Path(__file__).parents[3] / "configs/fleets/paper.toml"


def test_only_nodes_that_are_called_ground_are_grounds() -> None:
    nodes = BusNodes(load_fleet(PAPER), "mav0")
    for node in ("ground1", "groundling", "watcher-12-ab"):
        nodes.update(node, True, 0)
        assert not nodes.has_ground, node

    nodes.update("ground-12-ab", True, 0)
    assert nodes.has_ground
    nodes.update("ground-12-ab", False, 0)
    assert not nodes.has_ground
