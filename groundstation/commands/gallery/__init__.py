"""``covey gallery``: missions worth flying, with what each one shows.

Examples:
  covey gallery
  covey gallery swap
  covey gallery thirty --record flights/thirty
  covey fly search --sitl

They are flown in lockstep, each in seconds. Exit status: 0 all that the mission declares came true;
1 something did not; 2 wrong input, nothing started; 130 interrupted.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from groundstation.commands.fly import fly_mission, new_folder
from groundstation.commands.gallery.catalogue import GALLERY, gallery_mission, sentence_of
from groundstation.commands.parameters import BusOptions, FlightOptions, LawName
from onboard.exit_status import EXIT_OK


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
        print(
            "Fly one in simulated time: covey gallery NAME. With console and real processes: covey fly NAME --sitl."
        )
        return EXIT_OK
    folder = record or new_folder()
    options = FlightOptions(record=folder, law=law, seed=seed, lockstep=True)
    return fly_mission(
        gallery_mission(name, folder),
        options,
        BusOptions(),
        is_simulated=True,
        has_free_ports=False,
    )
