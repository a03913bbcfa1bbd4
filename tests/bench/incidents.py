"""``make bench-incidents``: ten planted incidents, and whether ``covey incident`` names their
cause.

Each incident is the paper's mission, or an order to it, with one thing that breaks its promise, and
with three harmless ones beside it that are as conspicuous: another fault, a light wind, a number
that differs. The incident's folder is all that the explanation sees. What counts is the place of
the planted cause among the causes that are named: the first, or a later one.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from groundstation.cli import main as covey
from groundstation.commands.incident import trials_of
from groundstation.flights.recorded_flight import open_recorded
from groundstation.incident.findings import Findings, findings_of
from groundstation.starter.fleet_edit import edited
from onboard.config.fleet import load_fleet

FLEET = Path(__file__).parents[2] / "configs/fleets/paper.toml"
MISSION = "paper"


class Planted(NamedTuple):
    """One incident: what breaks the promise, and how the explanation has to call it."""

    name: str
    named: str  # a part of the sentence about the right cause
    options: tuple[str, ...] = ()  # of covey fly
    fleet: Mapping[str, object] = MappingProxyType({})  # its values, tables in tables


_HARMLESS_FAULT = ("--fault", "mav2 link_duplicate at=9 duration=2 share=0.2")
_HARMLESS_WIND = ("--wind-m-s", "1,0")
_HARMLESS_NUMBER = {"law": {"crowd_count": 5}}

# lands as soon as it has taken off
_NO_BATTERY = {"battery_land_pct": 97.0, "battery_warning_pct": 99.0}

INCIDENTS = (
    Planted("motor", "motor_dead", ("--fault", "mav1 motor_dead at=11 motor=2")),
    Planted("swap", "mocap_swapped", ("--fault", "mav0 mocap_swapped at=11.5 other=mav1")),
    Planted("pilot", "pilot", ("--fault", "mav1 pilot at=10.5 mode=posctl")),
    Planted("agent", "agent_dead", ("--fault", "mav0 agent_dead at=11")),
    Planted("kill", "kill mav1", ("--order", "11 kill mav1")),
    Planted("land", "land mav2", ("--order", "10 land mav2")),
    Planted("wind", "calm air", ("--wind-m-s", "11,0", "--gust-m-s", "2")),
    Planted("law", "Covey's law", ("--law", "off")),
    Planted("bus", "delay_s", ("--bus-delay-s", "0.7")),
    Planted("battery", "battery_land_pct", fleet={"fleet": _NO_BATTERY}),
)


class Answer(NamedTuple):
    """What became of one incident."""

    name: str
    is_incident: bool  # the promise was broken, or the mission did not come true
    place: int  # of the right cause among those that are named; 0: not among them
    causes: tuple[str, ...]


def answered(planted: Planted, folder: Path) -> Answer:
    """Fly an incident, let it be explained, and look for the right cause.

    Args:
        planted: the incident.
        folder: for its files; empty.
    """
    fleet = folder / "fleet.toml"
    text = edited(FLEET.read_text(), _HARMLESS_NUMBER)
    fleet.write_text(edited(text, planted.fleet))

    has_wind = "--wind-m-s" in planted.options
    options = [*planted.options, *_HARMLESS_FAULT]
    if not has_wind:
        options.extend(_HARMLESS_WIND)

    flight = folder / "flight"
    words = ["fly", MISSION, "--fleet", str(fleet), "--lockstep", "--record", str(flight)]
    with contextlib.redirect_stdout(io.StringIO()):
        status = covey([*words, *options])

    findings = explained(flight)
    causes = tuple(trial.candidate.what for trial in findings.causes)
    places = [number for number, what in enumerate(causes, start=1) if planted.named in what]
    return Answer(
        name=planted.name,
        is_incident=status != 0,
        place=places[0] if places else 0,
        causes=causes,
    )


def explained(flight: Path) -> Findings:
    """Return what would have kept the promise of a flight."""
    promise_m = load_fleet(flight / "fleet.toml").fleet.safety_distance_m
    trials = list(trials_of(open_recorded(flight)))
    return findings_of(trials, promise_m)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the place of the right cause in each incident; 1 if it is not first in nine of ten."""
    parser = argparse.ArgumentParser(
        prog="make bench-incidents",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--only", default="", metavar="NAMES", help="of incidents, with commas")
    options = parser.parse_args(argv)

    wanted = [name for name in options.only.split(",") if name]
    planted = [one for one in INCIDENTS if not wanted or one.name in wanted]
    firsts = 0
    for one in planted:
        with tempfile.TemporaryDirectory(prefix="covey-incident-") as folder:
            answer = answered(one, Path(folder))
        firsts += answer.place == 1
        trouble = "" if answer.is_incident else " (this was no incident)"
        named = "; ".join(answer.causes) or "none"
        print(f"{one.name:<8} place {answer.place}{trouble}: {named}", flush=True)

    print(f"The right cause was named first in {firsts} of {len(planted)}.")
    return 0 if 10 * firsts >= 9 * len(planted) else 1


if __name__ == "__main__":
    raise SystemExit(main())
