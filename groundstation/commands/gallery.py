"""``covey demo gallery``: missions worth flying, with what each one shows.

Examples:
  covey demo gallery
  covey demo gallery swap
  covey demo gallery thirty --record flights/thirty
  covey demo gallery london
  covey fly search --sitl

They are flown in lockstep, each in seconds. The four accidents are flown twice,
without the defence against them and with it. Exit status: 0 all expectations of
the mission came true; 1 one did not; 2 wrong input, nothing started; 50 some
vehicles did a step and others did not; 130 interrupted.
"""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.fly import fly_mission
from groundstation.commands.parameters import (
    BusOptions,
    FlightOptions,
    LawName,
    WorldOptions,
    refuse_wrong_seed,
)
from groundstation.flights.flight_settings import flight_folder
from groundstation.mission_files.loading import load_mission
from groundstation.shows.gallery import ACCIDENTS, GALLERY, SHOW, gallery_mission, sentence_of
from onboard.config.fleet import ConfigError
from onboard.exit_status import EXIT_OK
from sitl.lockstep.accidents import fly_both as fly_accident

_NARROWEST = 60
_WIDEST = 120


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
        name: name of the mission; by default all are listed
        record: flight folder (default: flights/<time>); not for an accident
        law: avoidance law instead of the fleet file's; not for an accident
        seed: seed of everything random in the emulator
    """
    if name is None:
        _print_list()
        return EXIT_OK

    if name in ACCIDENTS:
        if record is not None or law is not None:
            raise ConfigError(
                f"'{name}' is an accident: it is flown twice, with its own laws, and"
                " leaves no record. Leave --record and --law out."
            )
        refuse_wrong_seed(seed)
        return fly_accident(load_mission(name), seed=seed)

    with flight_folder(record) as folder:
        return fly_mission(
            gallery_mission(name, folder),
            FlightOptions(record=folder, law=law, seed=seed, lockstep=True),
            WorldOptions(),
            BusOptions(),
            is_simulated=True,
            has_free_ports=False,
        )


def _print_list() -> None:
    columns = shutil.get_terminal_size((_WIDEST, 24)).columns
    width = max(_NARROWEST, min(columns, _WIDEST))
    print(_listed(GALLERY, width))
    print(
        textwrap.fill(
            "Accidents that happened, flown without the defence against them and with it:", width
        )
    )
    print(_listed(ACCIDENTS, width))
    print("Fly one in simulated time: covey demo gallery NAME.")
    print(f"With console and real processes (all but {SHOW}): covey fly NAME --sitl.")


def _listed(names: Sequence[str], width: int) -> str:
    """Return the names with what they show, in lines of this width."""
    name_width = max(len(name) for name in (*GALLERY, *ACCIDENTS))
    indent = " " * (name_width + 4)
    lines = []
    for name in names:
        head = f"  {name:<{name_width}}  "
        lines += textwrap.wrap(
            sentence_of(name),
            width,
            initial_indent=head,
            subsequent_indent=indent,
            break_on_hyphens=False,
        )
    return "\n".join(lines)
