"""The doors by which Covey opens files of others, each file in a process with limits.

What comes of a file is ``refused`` with the sentence, ``read``, or the name of an exception that is
no refusal.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import os
import resource
import shutil
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, NoReturn
from unittest.mock import AsyncMock

from onboard.config.fleet import ConfigError

MAX_S = 25.0  # by the clock
MAX_BYTES = 6 << 30  # of addresses: more than any machine's part for one file


def _show(path: Path) -> None:
    from groundstation.shows.import_show import import_show, read_show

    show = read_show(path)
    with tempfile.TemporaryDirectory() as folder:
        import_show(show, Path(folder) / "out", path.name, None, None)


def _path(path: Path) -> None:
    from groundstation.paths.path_files import load_path

    load_path(path)


def _lights(path: Path) -> None:
    from groundstation.paths.lights import load_lights

    load_lights(path)


def _picture(path: Path) -> None:
    from groundstation.formations.slot_drawing import image_slots

    image_slots(str(path), 4)


def _font(path: Path) -> None:
    from groundstation.formations.slot_drawing import text_slots

    text_slots("PX4", str(path), 4)


def _fence(path: Path) -> None:
    from groundstation.starter.fence_files import read_fences, toml_of

    toml_of(read_fences(path))


def _rtcm(path: Path) -> None:
    """Open a recording of RTCM, and read what each of its frames says."""
    from onboard.corrections.relay.sources import frames_of_file
    from onboard.corrections.rtcm import base_of, ends_epoch, number_of, station_of

    for frame in frames_of_file(str(path)):
        number_of(frame)
        station_of(frame)
        base_of(frame)
        ends_epoch(frame)


def _px4_log(path: Path) -> None:
    from groundstation.px4_logs.px4_log import read_log

    read_log(path)


def _script(path: Path) -> None:
    from groundstation.crazyswarm import script_check

    script_check.is_of_crazyswarm(str(path))
    script_check.refuse_what_is_not_flown(str(path))
    script_check.longest_timescale(str(path))


def _fleet(path: Path) -> None:
    from onboard.config.fleet import load_fleet

    load_fleet(path)


def _mission(path: Path) -> None:
    from groundstation.mission_files.loading import load_mission

    load_mission(path, "paper")


def _record(path: Path) -> None:
    from groundstation.recording.timeline import Timeline

    with contextlib.closing(Timeline(path)) as timeline:
        for _ in timeline.samples(timeline.topics):
            pass


def _replay(path: Path) -> None:
    from groundstation.recording.timeline import Timeline

    timeline = Timeline(path)
    timeline.close()


def _flown(path: Path) -> None:
    """Open a flight that was simulated, as ``covey incident`` and ``covey replay`` do."""
    from groundstation.flights.recorded_flight import fleet_of, mission_of, open_recorded

    flown = open_recorded(path)
    fleet = fleet_of(flown.origin.fleet_text, path / "fleet.toml")
    mission_of(flown, flown.origin, fleet)


def _log_info(path: Path) -> None:
    from groundstation.commands.log import info

    with contextlib.redirect_stdout(io.StringIO()):
        info(path)


def _identify(path: Path) -> None:
    from groundstation.identification.identified_flight import identify_flight

    identify_flight(path, None, None)


def _report(path: Path) -> None:
    from groundstation.report.flight_page import write_page

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "report.html"
        write_page(path, out, fleet_path=None, compared=path, tiles=None)


def _evidence(path: Path) -> None:
    """Open a folder of evidence, or one that has only this file."""
    from groundstation.evidence.evidence_summary import EVIDENCE_NAME, read_evidence

    if not path.is_file():
        read_evidence(path)
        return

    with tempfile.TemporaryDirectory() as folder:
        shutil.copyfile(path, Path(folder) / EVIDENCE_NAME)
        read_evidence(Path(folder))


def _kept_flights(path: Path) -> None:
    from groundstation.evidence.kept_flights import KeptFlights

    KeptFlights(path, {"fleet": "a"})


def _params(path: Path) -> None:
    from groundstation.px4.parameter_file import read_file

    read_file(path)


def _certificate(path: Path) -> None:
    from onboard.security.certificates import read_certificate

    read_certificate(str(path))


def _key(path: Path) -> None:
    from onboard.security.certificates import read_key

    read_key(str(path))


def _mavlink_key(path: Path) -> None:
    from onboard.security.mavlink_key import read_key

    read_key(str(path), "fleet.toml")


def _results(path: Path) -> None:
    from sitl.monte_carlo.law_map.results_file import ResultsFile

    ResultsFile(path, "1")


def _scene(path: Path) -> None:
    from sitl.monte_carlo.open_benchmark import scene_file, scene_plans

    scene_plans.setup(scene_file.load(path))


def _law(path: Path) -> None:
    from onboard.config.law_import import find_own_law

    find_own_law("pipe:law", [str(path.parent)], "fleet.toml: 'law.name'")


def _web(path: Path) -> None:
    from groundstation.web import page_server

    text = path.read_text(encoding="utf-8", errors="replace")
    asyncio.run(page_server.obey(text, AsyncMock()))


DOORS: dict[str, Callable[[Path], None]] = {
    "show": _show,
    "path": _path,
    "lights": _lights,
    "picture": _picture,
    "font": _font,
    "fence": _fence,
    "rtcm": _rtcm,
    "px4 log": _px4_log,
    "script": _script,
    "fleet": _fleet,
    "mission": _mission,
    "record": _record,
    "replay": _replay,
    "flown": _flown,
    "log info": _log_info,
    "identify": _identify,
    "report": _report,
    "evidence": _evidence,
    "kept flights": _kept_flights,
    "params": _params,
    "certificate": _certificate,
    "key": _key,
    "mavlink key": _mavlink_key,
    "results": _results,
    "scene": _scene,
    "law": _law,
    "web": _web,
}


class Outcome(NamedTuple):
    """What came of opening one file."""

    kind: str  # "refused", "read", "killed", or the name of an exception
    sentence: str
    seconds: float  # of opening, without the imports
    memory_mb: float  # the most at a time, beyond what the imports took


def outcome_of(door: str, path: Path) -> Outcome:
    """Open a file here."""
    before_mb = _peak_mb()
    begin_s = time.monotonic()
    kind = "read"
    sentence = ""
    try:
        DOORS[door](path)
    except ConfigError as error:
        kind = "refused"
        sentence = str(error)
    except BaseException as error:  # noqa: BLE001 - whatever comes is what is measured
        kind = type(error).__name__
        sentence = str(error)[:200]
    return Outcome(kind, sentence, time.monotonic() - begin_s, _peak_mb() - before_mb)


def outcome_in_process(door: str, path: Path, timeout_s: float = MAX_S) -> Outcome:
    """Open a file in a child with limits, which has all imports of this process."""
    with tempfile.TemporaryFile("w+") as out:
        begin_s = time.monotonic()
        pid = os.fork()
        if pid == 0:
            _open_under_limits(door, path, out.fileno())

        kind = "killed"
        while True:
            ended, status, usage = os.wait4(pid, os.WNOHANG)
            if ended:
                break
            if time.monotonic() - begin_s > timeout_s:
                kind = "without end"
                os.kill(pid, signal.SIGKILL)
                _, status, usage = os.wait4(pid, 0)
                break
            time.sleep(0.01)
        out.seek(0)
        text = out.read()

    if kind == "without end" or status or not text:
        memory_mb = usage.ru_maxrss / 1024.0 - _peak_mb()
        return Outcome(kind, "", time.monotonic() - begin_s, memory_mb)
    return Outcome(*json.loads(text))


def _open_under_limits(door: str, path: Path, descriptor: int) -> NoReturn:
    """Open a file, write its outcome, and end this process."""
    resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    outcome = outcome_of(door, path)
    os.write(descriptor, json.dumps(outcome).encode())
    os._exit(0)


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def warm_up() -> None:
    """Import what the doors import, so that only the file is measured."""
    with tempfile.TemporaryDirectory() as folder:
        for door in DOORS:
            outcome_of(door, Path(folder) / "none")
    from groundstation.formations import slot_drawing

    slot_drawing.text_slots("A", None, 2)
