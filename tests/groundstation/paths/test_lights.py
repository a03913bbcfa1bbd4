"""Colours along a path, as files and at times."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.console.theme import light_colour
from groundstation.paths.lights import colour_at, load_lights
from onboard.config.fleet import ConfigError


def test_colours_change_evenly_between_their_times(tmp_path: Path) -> None:
    (tmp_path / "lights.csv").write_text(
        "t,red,green,blue\n1,0,0,0\n2,200,0,0\n2,0,0,255\n4,0,0,255\n", encoding="utf-8"
    )
    lights = load_lights(tmp_path / "lights.csv")
    wanted = {0.0: (0, 0, 0), 1.5: (100, 0, 0), 2.5: (0, 0, 255), 9.0: (0, 0, 255)}
    assert {time_s: colour_at(lights, time_s) for time_s in wanted} == wanted
    assert light_colour((100, 0, 0)) == "#640000"
    assert light_colour((0, 0, 0)) != "#000000"


@pytest.mark.parametrize(
    "text",
    [
        "t,x,y,z\n0,0,0,0\n",
        "t,red,green,blue\n0,0,0,256\n",
        "t,red,green,blue\n0,0.9,0.5,0.1\n",
        "t,red,green,blue\n1,0,0,0\n0,0,0,0\n",
    ],
)
def test_what_is_no_colour_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "lights.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"lights\.csv"):
        load_lights(tmp_path / "lights.csv")
