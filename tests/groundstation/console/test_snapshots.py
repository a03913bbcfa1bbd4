"""Every screen as it was looked at and found good.

After a change that is wanted: ``pytest --snapshot-update``.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from importlib.metadata import version

import pytest
from textual.app import App
from textual.pilot import Pilot

from groundstation.console.app import ConsoleApp
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.scenes import (
    START_NS,
    SteadyClient,
    crowd,
    fly,
    ground_and_sky,
    warm,
)

TAKEN_WITH = "8.2"
pytestmark = pytest.mark.skipif(
    not version("textual").startswith(TAKEN_WITH),
    reason=f"the pictures were drawn by Textual {TAKEN_WITH}; another draws its parts otherwise",
)
SIZES = [(80, 24), (120, 40), (200, 60)]
Compare = Callable[..., bool]
Before = Callable[[Pilot[int]], Awaitable[None]]


@pytest.fixture(autouse=True)
def steady(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same terminal and the same time of day for everybody."""
    for name in ("NO_COLOR", "COLORFGBG", "COVEY_THEME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("COVEY_ASCII", "0")
    monkeypatch.setattr(time, "strftime", lambda *_: "12:00:00")
    monkeypatch.setattr(App, "TITLE", "covey")


def scene(client: SteadyClient, app: ConsoleApp, *keys: str, seconds: float = 40.0) -> Before:
    """A flight of some time, then one silent, one not ready, one failed; then keys."""

    async def before(pilot: Pilot[int]) -> None:
        await warm(app, client, seconds)
        names = client.fleet.enabled_names
        ground_and_sky(client)
        if len(names) > 3:
            silent = client.state.vehicles[names[3]]
            client.clock_ns = START_NS + int((seconds + 2.2) * 1e9)
            fly(client, seconds + 2.2)
            ground_and_sky(client)
            views = {**client.state.vehicles, names[3]: silent}
            client.state = type(client.state)(vehicles=views, smallest=client.state.smallest)
        client.say("takeoff: 1.00 m reached", "info", names[0], "done")
        client.say("Battery at 18 %: land soon", "warning", names[1])
        app.refresh_fleet()
        await pilot.press(*keys)
        app.refresh_fleet()
        await pilot.pause()

    return before


def console(fleet: FleetConfig) -> tuple[SteadyClient, ConsoleApp]:
    client = SteadyClient(fleet)
    return client, ConsoleApp(fleet, client, title="first flight")


def test_before_anybody_answers(snap_compare: Compare, fleet: FleetConfig) -> None:
    _, app = console(fleet)
    assert snap_compare(app, terminal_size=SIZES[0])


@pytest.mark.parametrize("size", SIZES)
def test_a_fleet_in_flight(snap_compare: Compare, size: tuple[int, int]) -> None:
    client, app = console(crowd(8, side_m=14.0))
    assert snap_compare(app, terminal_size=size, run_before=scene(client, app, "down", "space"))


def test_a_crowd(snap_compare: Compare) -> None:
    client, app = console(crowd(100))
    assert snap_compare(
        app, terminal_size=SIZES[1], run_before=scene(client, app, "s", "s", seconds=4.0)
    )


@pytest.mark.parametrize("key", ["question_mark", "q"])
def test_dialogs_over_the_console(snap_compare: Compare, key: str) -> None:
    client, app = console(crowd(8, side_m=14.0))
    assert snap_compare(app, terminal_size=SIZES[0], run_before=scene(client, app, key))


def test_the_plan_alone_on_a_light_ground(snap_compare: Compare) -> None:
    client, app = console(crowd(8, side_m=14.0))
    assert snap_compare(
        app, terminal_size=(120, 40), run_before=scene(client, app, "tab", "z", "t")
    )


def test_ascii_without_colour(snap_compare: Compare, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COVEY_ASCII", "1")
    client, app = console(crowd(8, side_m=14.0))
    assert snap_compare(app, terminal_size=(80, 24), run_before=scene(client, app))


def test_a_verdict_leaves_the_plan_its_room(snap_compare: Compare, fleet: FleetConfig) -> None:
    class Verdict:
        passed = True
        sentences = (
            "Takeoff reached 1.00 m.",
            "All slots reached within 0.09 m.",
            "Least distance 0.84 m: ok.",
        )

    async def mission() -> Verdict:
        return Verdict()

    client = SteadyClient(fleet)
    app = ConsoleApp(fleet, client, mission=mission, title="first flight")
    assert snap_compare(app, terminal_size=SIZES[0], run_before=scene(client, app, seconds=10.0))
