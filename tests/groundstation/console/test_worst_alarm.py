"""The worst alarm stands on the last line of whatever is on the screen, in full colour."""

from __future__ import annotations

from typing import Any

import pytest
from textual.screen import Screen

from groundstation.console import theme
from groundstation.console.app import ConsoleApp
from groundstation.console.screens.alarms_screen import AlarmsScreen
from groundstation.console.screens.dialogs import HelpScreen, QuitScreen
from groundstation.console.screens.preview_screen import PreviewScreen
from groundstation.console.screens.vehicle_screen import VehicleScreen
from onboard.config.fleet import FleetConfig
from tests.groundstation.console.fake import FakeClient
from tests.groundstation.console.live import until
from tests.groundstation.console.rig import Oracle
from tests.groundstation.console.seeing import strips

SCREENS: list[tuple[str, type[Screen[Any]]]] = [
    ("question_mark", HelpScreen),
    ("q", QuitScreen),
    ("f2", PreviewScreen),
    ("A", AlarmsScreen),
    ("enter", VehicleScreen),
]


def last_line(app: ConsoleApp) -> list[tuple[str, str]]:
    """Pieces of the terminal's last line with their colours."""
    strip = strips(app)[-1]
    colour = [segment.style.color if segment.style else None for segment in strip]
    return [
        (segment.text, one.name if one else "") for segment, one in zip(strip, colour, strict=True)
    ]


@pytest.mark.parametrize(("key", "screen"), SCREENS, ids=[screen.__name__ for _, screen in SCREENS])
async def test_the_worst_alarm_is_visible_on_every_screen(
    fleet: FleetConfig, key: str, screen: type[Screen[Any]]
) -> None:
    client = FakeClient(fleet)
    app = ConsoleApp(fleet, client, forecaster=Oracle())

    def worst(battery_frac: float) -> tuple[str, str]:
        for name in fleet.enabled_names:  # again and again: silence would be another alarm
            client.hear(
                name, position_enu_m=fleet.vehicles[name].start_enu_m, battery_frac=battery_frac
            )
        return next((piece for piece in last_line(app) if "✖" in piece[0]), ("", ""))

    async with app.run_test(size=(80, 24)) as pilot:
        worst(0.8)
        await pilot.press(key)
        await until(pilot, lambda: isinstance(app.screen, screen))
        await until(
            pilot, lambda: worst(0.8) == ("", "") and "all well" in str(last_line(app)), 10.0
        )
        # what comes while this screen is in front
        await until(pilot, lambda: "mav0" in worst(0.05)[0], 10.0)
        sentence, colour = worst(0.05)
        assert "battery" in sentence.lower()
        assert colour == theme.BAD


@pytest.mark.parametrize(
    ("size", "advice"),
    [
        ((80, 24), "Start covey agent, "),  # the remedy comes first, because the line is cut
        ((120, 40), "Start covey agent, or fly --sitl, unless they start now."),
    ],
    ids=str,
)
async def test_a_console_that_hears_nobody_says_what_to_start(
    fleet: FleetConfig, size: tuple[int, int], advice: str
) -> None:
    app = ConsoleApp(fleet, FakeClient(fleet), forecaster=Oracle())

    def said() -> str:
        return "".join(piece for piece, _ in last_line(app))

    # beside the three names and a long wait
    async with app.run_test(size=size) as pilot:
        await until(pilot, lambda: "Waiting for mav0, mav1, mav2" in said(), 10.0)
        assert advice in said()
