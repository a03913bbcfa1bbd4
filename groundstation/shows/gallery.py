"""The missions of the gallery, by name: files in configs/missions, and one imported show.

Four further files are real accidents; ``sitl/lockstep/accidents.py`` makes them happen again.
"""

from __future__ import annotations

from pathlib import Path

from groundstation.mission_files.loading import load_mission
from groundstation.mission_files.mission import Mission
from groundstation.shows.output import write_show
from groundstation.shows.skyc import read_skyc
from onboard.config.example_files import EXAMPLES
from onboard.config.fleet import ConfigError
from onboard.plain_text import meant_words

SHOW = "thirty"  # a .skyc file, which is imported before it flies
GALLERY = (
    "paper",
    "swap",
    "dense-swap",
    "square-dance",
    "layers",
    "above",
    "leader",
    "circle",
    "search",
    "escort",
    "rooms",
    "gap",
    "maze",
    "evacuation",
    "intruder",
    "visitor",
    "mocap-lost",
    SHOW,
)
# Real accidents: each is flown without its defence and with it.
ACCIDENTS = ("orlando", "docklands", "aaib-29203", "london")
_SHOW_SENTENCE = (
    "Show of thirty: a show of another program, imported: five rows of six turn with a wave"
    " through them."
)


def gallery_mission(name: str, folder: Path) -> Mission:
    """Return a mission of the gallery; the show is imported first.

    Args:
        name: one of GALLERY.
        folder: the flight folder, to which the imported show is written.

    Raises:
        ConfigError: there is no such mission.
    """
    if name not in GALLERY:
        names = (*GALLERY, *ACCIDENTS)
        raise ConfigError(
            f"'{name}' is no mission of the gallery.{meant_words(name.lower(), names)}"
            f" It has {', '.join(names)}."
        )
    if name != SHOW:
        return load_mission(_file(name))

    source = Path(EXAMPLES) / "shows" / f"{SHOW}.skyc"
    show_folder = folder / "show"
    show_folder.mkdir(parents=True, exist_ok=True)
    write_show(read_skyc(source), show_folder, source.name, None, None)
    return load_mission(show_folder / "mission.toml")


def sentence_of(name: str) -> str:
    """Return what a mission shows, in words: the comment at the start of its file."""
    if name == SHOW:
        return _SHOW_SENTENCE

    lines = []
    for line in _file(name).read_text(encoding="utf-8").splitlines():
        if not line.startswith("# "):
            break
        lines.append(line.removeprefix("# "))
    return " ".join(lines)


def _file(name: str) -> Path:
    return Path(EXAMPLES) / "missions" / f"{name}.toml"
