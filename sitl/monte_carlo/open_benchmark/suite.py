"""The suite: all scenes flown by one law, unit by unit, and what is kept of each flight."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from sitl.monte_carlo import batch_flight, results, worlds
from sitl.monte_carlo.campaign_settings import Setup
from sitl.monte_carlo.law_map.results_file import ResultsKind
from sitl.monte_carlo.open_benchmark import scene_file, scene_plans
from sitl.monte_carlo.open_benchmark.judged_law import JudgedLaw
from sitl.monte_carlo.open_benchmark.scene_file import Scene

SuiteRow = dict[str, Any]  # one line of the file of results


class KeptFlight(msgspec.Struct, frozen=True):
    """What a row keeps of the record of each flight, and the energy."""

    seed: int
    success: bool
    reason: str | None
    violation_s: float
    collision: bool
    min_separation_m: float
    ratio: float | None
    straight_line_s: float | None
    slew_rms_m_s3: float
    energy_hover_s: float


KIND = ResultsKind(
    head="open_benchmark",
    command="covey simulate --suite open",
    option="--keep",
    numbers=("first_seed", "busy_s", "calls"),
    others=("law", "scene", "flights"),
    flight=KeptFlight,
)
# seeds in a unit of a law that flies compiled; a unit of a user's own law has one seed
_SEEDS_OF_UNIT = 5
_COST_SCENE = "circle"  # in which laws are timed
# A longer scene is no part of the suite: in RotorPy's physics one flight of it takes 20 minutes.
_LONGEST_S = 300.0


@dataclass(frozen=True, slots=True)
class Unit:
    """Some seeds of one scene by one law: the smallest piece of work whose results are kept."""

    law: str
    source_hash: str  # of a user's own law; empty for Covey's
    scene: Scene
    seeds: tuple[int, ...]
    physics: str = worlds.DEFAULT

    @property
    def cell(self) -> str:
        """Key of the unit in the file of results.

        It has digests of scene and law, so that it changes when one of them is edited.
        """
        scene = hashlib.sha256(msgspec.json.encode(self.scene)).hexdigest()[:8]
        seeds = f"{self.seeds[0]}:{self.seeds[-1] + 1}"
        key = f"{self.law} {self.source_hash} {self.scene.name} {scene} {seeds}"
        if self.physics != worlds.DEFAULT:
            key += f" {self.physics}"
        return key


def source_hash(row: SuiteRow) -> str:
    """Return the hash of the law's source in the key of a row; empty for Covey's."""
    _, _, after_law = str(row["cell"]).partition(" ")
    law_hash, _, _ = after_law.partition(" ")
    return law_hash


def scenes() -> list[Scene]:
    """Return the scenes of the suite: those of this software that are over in a few minutes."""
    known = [scene_file.packaged(name) for name in scene_file.names()]
    return [scene for scene in known if scene.within_s is None or scene.within_s <= _LONGEST_S]


def units(law: str, seeds: range, physics: str = worlds.DEFAULT) -> list[Unit]:
    """Return the units of a law, seed by seed, so that an interrupted run has flown all scenes.

    Raises:
        ConfigError: the law cannot be imported, or there is no such physics.
    """
    worlds.world_of(physics)  # refuses an unknown name
    with redirect_stdout(sys.stderr):  # where an own law may print
        judged = JudgedLaw(_setup(scenes()[0], law))  # any scene: only the law matters here
    size = _SEEDS_OF_UNIT
    if judged.is_own:
        size = 1
    found = []
    for index in range(0, len(seeds), size):
        part = tuple(seeds[index : index + size])
        for scene in scenes():
            unit = Unit(
                law=law,
                source_hash=judged.source_hash,
                scene=scene,
                seeds=part,
                physics=physics,
            )
            found.append(unit)
    return found


def _setup(scene: Scene, law: str) -> Setup:
    """Return the settings of a scene; the paper's law flies with any number of vehicles here."""
    changes: tuple[str, ...] = ()
    if law == "paper":
        changes = ("law.paper_force_ring=true",)
    return scene_plans.setup(scene, law=law, changes=changes)


def fly(unit: Unit) -> SuiteRow:
    """Fly a unit; return its row. What a law prints goes to standard error.

    Raises:
        ConfigError: the law was edited since the unit was made.
    """
    with redirect_stdout(sys.stderr):
        return _flown(unit)


def _flown(unit: Unit) -> SuiteRow:
    setup = _setup(unit.scene, unit.law)
    judged = JudgedLaw(replace(setup, law_hashes={**setup.law_hashes, unit.law: unit.source_hash}))
    plans = [scene_plans.plan(unit.scene, seed) for seed in unit.seeds]
    is_timed = unit.scene.name == _COST_SCENE
    if judged.is_own:
        flown = batch_flight.fly(
            plans, judged.setup, controller=judged.interpreted, physics=unit.physics
        )
    else:
        flown = batch_flight.fly(plans, judged.setup, physics=unit.physics)
        if is_timed:
            batch_flight.fly(plans[:1], judged.setup, controller=judged.interpreted)

    busy_s = 0.0
    calls = 0
    if is_timed:
        busy_s = judged.busy_s
        calls = judged.calls

    return {
        "cell": unit.cell,
        "stage": 0,  # a unit of the suite has one stage, unlike those of the map
        "law": unit.law,
        "physics": unit.physics,
        "scene": unit.scene.name,
        "first_seed": unit.seeds[0],
        "flights": [_kept(flight, judged) for flight in flown],
        "busy_s": busy_s,
        "calls": calls,
    }


def _kept(flown: batch_flight.Flown, judged: JudgedLaw) -> results.FlightRecord:
    """Return what is kept of a flight; a flight whose law was refused has failed."""
    record = results.record(flown, judged.setup)
    record["energy_hover_s"] = round(flown.outcome.energy_hover_s, 3)
    values = {key: record[key] for key in KeptFlight.__struct_fields__}
    if flown.law_refusal:
        values["success"] = False
        values["reason"] = f"law {flown.law_refusal}"
    return values


def flights_of(rows: Sequence[SuiteRow]) -> list[results.FlightRecord]:
    """Return the flights of several rows.

    Units of several seeds overlap after a run with other seeds, for instance 1000:1003 and then
    1000:1005. Each flight counts once.
    """
    flights: dict[tuple[str, str, str, int], results.FlightRecord] = {}
    for row in rows:
        contestant = (row["law"], row.get("physics", worlds.DEFAULT), row["scene"])
        for flight in row["flights"]:
            flights[*contestant, flight["seed"]] = flight
    return list(flights.values())
