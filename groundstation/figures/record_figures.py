"""``covey plot``: writes all figures of a recorded flight, the paper's Figs. 2 and 4-6."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from groundstation.figures import attitude, avoidance, plan_figure, tracking
from groundstation.figures.data import POSES, TOPICS, from_samples
from groundstation.figures.style import refuse_other_picture, save, saved_paths, styled
from groundstation.recording.reader import record_path
from groundstation.recording.timeline import Timeline
from onboard.config.fleet import ConfigError, load_fleet
from onboard.config.flight_space import outlines_of
from onboard.plain_text import plain_line

_DEFAULT_SAFETY_DISTANCE_M = 0.80  # that of the paper
_FIGURES = {
    "fig2_attitude": attitude,
    "fig4_plan": plan_figure,
    "fig5_tracking": tracking,
    "fig6_avoidance": avoidance,
}


def draw_record(folder: Path, out: Path | None = None) -> tuple[list[Path], list[str]]:
    """Write all figures of a record as PNG and SVG.

    Of a damaged record the figures show what can be read.

    Args:
        folder: flight folder, or its MCAP file.
        out: folder of the figures; None for ``figures`` in the flight folder.

    Returns:
        Paths of the figures, and sentences about what is damaged or missing in the folder.

    Raises:
        ConfigError: there is no record, or it contains no flight; or in ``out`` is a file with the
            name of a figure that is none.
        OSError: the figures cannot be written.
    """
    if out is not None:
        for name in _FIGURES:
            for figure_path in saved_paths(out, name):
                refuse_other_picture(figure_path, option="--out")
    path = record_path(folder)
    flight_folder = folder
    if not folder.is_dir():
        flight_folder = folder.parent

    title = flight_folder.resolve().name
    notes: list[str] = []
    limits = _limits(flight_folder, notes)
    topics = list(TOPICS)
    if limits.get("people"):
        topics.append(POSES)
    with contextlib.closing(Timeline(path)) as timeline:
        flight = from_samples(
            timeline.samples(topics),
            title=title,
            record_begin_ns=timeline.begin_ns,
            **limits,
        )
        notes += timeline.damage
    if flight is None:
        raise ConfigError(
            f"{path}: no vehicle's ticks are in this record, so there is nothing to draw. It was"
            " cut off at its beginning, or no agent ran. Record a flight with `covey demo --record"
            " DIR`."
        )

    if not flight.took_off:
        notes.append("nobody took off in this record; the figures' time is that of the record.")
    target = flight_folder / "figures"
    if out is not None:
        target = out
    target.mkdir(parents=True, exist_ok=True)
    paths: list[Path] = []
    with styled():
        for name, module in _FIGURES.items():
            paths += save(module.draw(flight), target, name)
    return paths, notes


def _limits(flight_folder: Path, notes: list[str]) -> dict[str, Any]:
    """Return distances, fences and persons of the fleet file in the folder.

    Without a fleet file that can be read, the paper's distance is returned, and a note says why.
    """
    path = flight_folder / "fleet.toml"
    reason = "there is no fleet.toml beside the record"
    if path.exists():
        try:
            config = load_fleet(path, needs_folders=False)
        except ConfigError as error:
            reason = plain_line(str(error))[:300].rstrip(".")
        else:
            return {
                "safety_distance_m": config.fleet.safety_distance_m,
                "height_share": config.fleet.height_share,
                "outlines": outlines_of(config),
                "people": config.people,
            }

    notes.append(
        f"the figures show the paper's safety distance of {_DEFAULT_SAFETY_DISTANCE_M:.2f} m, and"
        f" neither fences nor persons: {reason}."
    )
    return {"safety_distance_m": _DEFAULT_SAFETY_DISTANCE_M}
