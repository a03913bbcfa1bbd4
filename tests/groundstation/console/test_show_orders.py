"""Orders to a show that flies: skipping the rest is shown first, with the weakest battery."""

from __future__ import annotations

from groundstation.console.screens.preview_screen import PreviewScreen
from groundstation.console.widgets.result_lines import ResultLines
from tests.groundstation.console.rig import SLOTS, Rig
from tests.groundstation.console.seeing import words


def fly_a_show(rig: Rig, **changes: object) -> None:
    """All follow paths that end a metre north of where they are, and stand in a pause."""
    for name, (x, y, _) in SLOTS.items():
        rig.client.hear(
            name,
            state="flying",
            velocity_enu_m_s=(0.0, 0.0, 0.0),
            position_enu_m=(x, y, 1.0),
            goal_position_enu_m=(x, y + 1.0, 1.5),
            show_id="s",
            is_path_paused=True,
            **{"battery_frac": 0.62, **changes},
        )


async def test_skipping_the_rest_shows_the_ends_of_the_paths_and_the_weakest_battery(
    rig: Rig,
) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        fly_a_show(rig)
        rig.client.hear("mav1", battery_frac=0.51, show_id="s", goal_position_enu_m=(0.0, 1.0, 1.5))
        await pilot.press("E")
        await pilot.pause(0.02)
        assert isinstance(rig.app.screen, PreviewScreen)
        shown = words(rig.app, "vehicles")
        assert "0 mav0  → -1.50 1.00 1.50 m" in shown
        assert "weakest battery: mav1, 51 %" in shown
        assert "leaves for home at" in shown
        assert rig.client.ordered == []
        fly_a_show(rig)
        rig.client.skew_ns += int(0.4e9)
        await pilot.press("enter")
        assert rig.client.ordered == ["skip mav0,mav1,mav2"]


async def test_pause_and_resume_are_sent_at_once(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        fly_a_show(rig)
        await pilot.press("p", "r")
        assert rig.client.ordered == ["pause mav0,mav1,mav2", "resume mav0,mav1,mav2"]


async def test_who_follows_no_path_is_refused_before_anything_is_sent(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        await pilot.press("E")
        assert "Nobody follows a path or another vehicle now" in rig.line(ResultLines)
        await rig.preview(pilot, "skip mav1")
        assert "mav1 follows no path" in words(rig.app, "answer")
        await pilot.press("enter")
        assert rig.client.ordered == []


async def test_who_follows_another_vehicle_is_paused_and_skips_to_where_it_is(rig: Rig) -> None:
    async with rig.app.run_test(size=(100, 30)) as pilot:
        rig.hover()
        fly = {"state": "flying", "position_enu_m": (1.5, 0.0, 1.0), "follows": "mav0"}
        rig.client.hear("mav2", goal_position_enu_m=(2.5, 0.0, 1.0), is_path_paused=True, **fly)
        await pilot.press("p", "r", "E")
        await pilot.pause(0.02)
        assert rig.client.ordered == ["pause mav2", "resume mav2"]
        assert "→ 1.50 0.00 1.00 m" in words(rig.app, "vehicles")
