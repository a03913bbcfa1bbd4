"""``covey gallery``: missions worth flying, with what each one shows.

Examples:
  covey gallery
  covey gallery swap
  covey gallery thirty --record flights/thirty
  covey fly swap --sitl

They are flown in lockstep, each in seconds. Exit status: 0 all that the mission declares came true; 1 something did
not; 2 wrong input, nothing started; 130 interrupted.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.fly import fly_mission, new_folder
from groundstation.commands.parameters import BusOptions, FlightOptions, LawName
from groundstation.missions.files import Mission, load_mission
from groundstation.shows.output import write_show
from groundstation.shows.skyc import read_skyc
from onboard.config.example_files import EXAMPLES
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK

SHOW = "thirty"
GALLERY = (
    "paper",
    "swap",
    "dense-swap",
    "square-dance",
    "layers",
    "leader",
    "circle",
    "search",
    "escort",
    "evacuation",
    "intruder",
    "mocap-lost",
    SHOW,
)
_SHOW_SENTENCE = "Show of thirty: a show of another program, imported: five rows of six turn with a wave through them."


def gallery(
    name: str | None = None,
    /,
    *,
    record: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    law: LawName = None,
    seed: int = 0,
) -> int:
    """List the missions of the gallery, or fly one of them in lockstep.

    Args:
        name: of the mission; without it all are listed
        record: flight folder (default: flights/<time>)
        law: avoidance law instead of the fleet file's
        seed: seed of everything random in the emulator
    """
    if name is None:
        width = max(map(len, GALLERY))
        print("\n".join(f"  {one:<{width}}  {sentence_of(one)}" for one in GALLERY))
        print("Fly one in simulated time: covey gallery NAME. With console and real processes: covey fly NAME --sitl.")
        return EXIT_OK
    folder = record or new_folder()
    options = FlightOptions(record=folder, law=law, seed=seed, lockstep=True)
    return fly_mission(gallery_mission(name, folder), options, BusOptions(), is_simulated=True, has_free_ports=False)


def gallery_mission(name: str, folder: Path) -> Mission:
    """Return a mission of the gallery; the show is imported first.

    Args:
        name: one of GALLERY.
        folder: of the flight, for the imported show.

    Raises:
        ConfigError: there is no such mission.
    """
    if name not in GALLERY:
        raise ConfigError(f"'{name}' is no mission of the gallery: it has {', '.join(GALLERY)}.")
    if name != SHOW:
        return load_mission(_file(name))
    source = Path(EXAMPLES) / "shows" / f"{SHOW}.skyc"
    made = folder / "show"
    made.mkdir(parents=True, exist_ok=True)
    write_show(read_skyc(source), made, source.name, None, None)
    return load_mission(made / "mission.toml")


def sentence_of(name: str) -> str:
    """Return what a mission shows: the comment at its begin."""
    if name == SHOW:
        return _SHOW_SENTENCE
    words = []
    for line in _file(name).read_text(encoding="utf-8").splitlines():
        if not line.startswith("# "):
            break
        words.append(line.removeprefix("# "))
    return " ".join(words)


def _file(name: str) -> Path:
    return Path(EXAMPLES) / "missions" / f"{name}.toml"
