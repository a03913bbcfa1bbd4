"""The missions of ``covey demo``: a ring of any number of vehicles, and a copy with keys."""

from __future__ import annotations

import datetime
import tomllib
from pathlib import Path

from msgspec.structs import replace

from groundstation.keys.secured_fleet import secure_fleet
from groundstation.mission_files.loading import with_fleet
from groundstation.mission_files.mission import Mission
from groundstation.processes.free_ports import in_another_folder, toml_text, with_free_ports
from groundstation.starter.starter_files import Answers, starter


def mission_of_ring(vehicles: int) -> Mission:
    """Return a mission in which this number of vehicles form a ring."""
    made = starter(Answers(name="demo", vehicles=vehicles, type="ardrone"))
    return replace(made.mission, path="demo.toml")


def locked_copy(mission: Mission, folder: Path) -> Mission:
    """Return a mission with a copy of its fleet on free ports and with keys of its own.

    Args:
        mission: the original; neither it nor its fleet file and keys are changed.
        folder: an existing folder for the copy.
    """
    fleet = mission.fleet
    data = in_another_folder(tomllib.loads(fleet.text), fleet)
    data = with_free_ports(data, fleet)

    file = folder / "fleet.toml"
    file.write_text(toml_text(data), encoding="utf-8")
    secured = secure_fleet(str(file), datetime.datetime.now(datetime.UTC))
    return with_fleet(mission, secured)
