"""``covey plot DIR``: the paper's Figs. 2 and 4-6 for a recorded flight, as PNG and SVG.

Example:
  covey plot flights/first

Exit status: 0 all was drawn; 2 nothing can be drawn, or the record breaks off (what it has is
drawn).
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.parameters import Folder
from groundstation.recording.reader import read, record_path
from onboard.config.fleet import ConfigError, load_fleet
from onboard.exit_status import EXIT_OK, EXIT_WRONG_INPUT

_MAGIC = b"\x89MCAP0\r\n"
_DEFAULT_SAFETY_DISTANCE_M = 0.80


def plot(folder: Annotated[Path, Parameter(name="DIR")], /, *, out: Folder | None = None) -> int:
    """Draw the figures of a recorded flight.

    Args:
        folder: flight folder, or its flight.mcap
        out: where to write (default: DIR/figures)
    """
    try:
        paths, is_whole = draw(folder, out)
    except OSError as error:
        raise ConfigError(
            f"the figures cannot be written: {error}. Give another place with --out."
        ) from None
    for path in paths:
        print(path)
    if is_whole:
        return EXIT_OK
    print(
        f"covey: {folder}: the record breaks off before its end, for instance because the recording process was "
        "killed. The figures show what it has.",
        file=sys.stderr,
    )
    return EXIT_WRONG_INPUT


def draw(folder: Path, out: Path | None = None) -> tuple[list[Path], bool]:
    """Write all figures; returns their paths and whether the record was complete.

    Raises:
        ConfigError: no record, or none with a flight in it.
    """
    path = record_path(folder)
    home = folder if folder.is_dir() else folder.parent
    from groundstation.figures import attitude, avoidance, plan_figure, tracking
    from groundstation.figures.data import TOPICS, from_samples
    from groundstation.figures.style import save, styled

    title = home.resolve().name
    flight = from_samples(read(path, TOPICS), title=title, **_limits(home))
    if flight is None:
        raise ConfigError(
            f"{path}: no vehicle's ticks are in this record, so there is nothing to draw. It was cut off at its "
            "beginning, or no agent ran. Record a flight with `covey demo --record DIR`."
        )
    target = out or home / "figures"
    target.mkdir(parents=True, exist_ok=True)
    drawn = {
        "fig2_attitude": attitude,
        "fig4_plan": plan_figure,
        "fig5_tracking": tracking,
        "fig6_avoidance": avoidance,
    }
    with styled():
        paths = [
            written
            for name, module in drawn.items()
            for written in save(module.draw(flight), target, name)
        ]
    return paths, is_complete(path)


def is_complete(path: Path) -> bool:
    """Whether an MCAP file ends as it should."""
    with path.open("rb") as file:
        file.seek(0, 2)
        size = file.tell()
        file.seek(max(0, size - len(_MAGIC)))
        return size > 2 * len(_MAGIC) and file.read() == _MAGIC


def _limits(home: Path) -> dict[str, float]:
    """From the fleet file in the flight folder; the paper's without one."""
    for path in sorted(home.glob("*.toml")):
        try:
            with path.open("rb") as file:
                is_fleet = "vehicles" in tomllib.load(file)
            if is_fleet:
                fleet = load_fleet(path).fleet
                return {
                    "safety_distance_m": fleet.safety_distance_m,
                    "height_share": fleet.height_share,
                }
        except (ConfigError, tomllib.TOMLDecodeError, UnicodeDecodeError):
            continue
    return {"safety_distance_m": _DEFAULT_SAFETY_DISTANCE_M}
