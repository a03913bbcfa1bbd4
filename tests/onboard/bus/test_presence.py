"""Names on the bus, and what happens when one comes twice, or thousands come and go."""

import random
from pathlib import Path

import pytest

from onboard import agent_inputs
from onboard.agent.inbox import Inbox
from onboard.bus.presence import Presence
from onboard.bus.protocol import OnAlive
from onboard.config.fleet import load_fleet
from onboard.config.mocap import MocapConfig

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"


def test_a_name_is_there_while_one_node_has_it() -> None:
    changes: list[tuple[str, bool]] = []
    presence = Presence(lambda *change: changes.append(change))
    for token, is_alive in (
        ("mav0/a", True), ("mav0/b", True), ("mav0/a", True), ("mav0/b", False), ("mav0/b", False),
        ("mav1/b", False),
    ):  # fmt: skip
        presence.see(token, is_alive)
    assert changes == [("mav0", True)]
    presence.see("mav0/a", False)
    assert changes[1:] == [("mav0", False)]


def test_any_sequence_ends_with_the_names_that_somebody_has() -> None:
    draw = random.Random(1)
    there: set[str] = set()

    def note(name: str, is_alive: bool) -> None:
        if is_alive:
            there.add(name)
        else:
            there.remove(name)

    presence = Presence(note)
    tokens: set[str] = set()

    for _ in range(2000):
        token = f"{draw.choice('abc')}/{draw.choice('123')}"
        is_alive = draw.random() < 0.5
        if is_alive:
            tokens.add(token)
        else:
            tokens.discard(token)

        presence.see(token, is_alive)
        assert there == {token[0] for token in tokens}


class _Bus:
    """A bus of which only the names matter."""

    node = "mav0"
    on_alive: OnAlive

    def watch_alive(self, on_alive: OnAlive) -> None:
        self.on_alive = on_alive

    def collect(self, *_: object, **__: object) -> None:
        pass

    subscribe = collect


@pytest.fixture
def bus() -> _Bus:
    return _Bus()


@pytest.fixture
def inbox(bus: _Bus) -> Inbox:
    inbox = Inbox(load_fleet(PAPER).vehicles["mav0"], 1, bus, MocapConfig())  # type: ignore[arg-type]
    inbox.start()
    return inbox


@pytest.mark.parametrize("prefix", ["false-", "ground-false-", "operator.1.false-"])
def test_thousands_of_false_names_cost_each_tick_little_and_push_nothing_out(
    inbox: Inbox, bus: _Bus, prefix: str
) -> None:
    inbox.notices.append(agent_inputs.ShutdownRequested())
    for is_alive in (True, False):
        for number in range(8000):
            bus.on_alive(f"{prefix}{number}", is_alive)
    bus.on_alive("ground-1", True)
    first = inbox.nodes_changed()
    assert agent_inputs.NodeChanged("ground-1", True) in first  # what came last is taken first
    assert len(first) <= 50
    assert list(inbox.notices) == [agent_inputs.ShutdownRequested()]
    left = [change for _ in range(200) for change in inbox.nodes_changed()]
    assert not any(change.is_alive for change in left)
