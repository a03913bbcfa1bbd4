"""The missions of ``covey demo``: of any number of vehicles, and on a bus with keys of its own."""

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
    """Return a mission in which as many vehicles as wanted form a ring."""
    made = starter(Answers(name="demo", vehicles=vehicles, type="ardrone"))
    return replace(made.mission, path="demo.toml")


def locked_copy(mission: Mission, folder: Path) -> Mission:
    """Return a mission with a copy of its fleet on free ports and with keys of its own.

    Args:
        mission: stays as it is, and so do its fleet file and the keys of that.
        folder: of the copy, there already.
    """
    fleet = mission.fleet
    data = in_another_folder(tomllib.loads(fleet.text), fleet)
    data = with_free_ports(data, fleet)

    file = folder / "fleet.toml"
    file.write_text(toml_text(data), encoding="utf-8")
    secured = secure_fleet(str(file), datetime.datetime.now(datetime.UTC))
    return with_fleet(mission, secured)
