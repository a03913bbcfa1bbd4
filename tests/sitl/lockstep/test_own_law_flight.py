"""The template's law flies in lockstep and campaigns; one that fails hands over to Covey's, and
events say why.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from groundstation import cli
from groundstation.file_checks.examination import examine
from groundstation.mission_files.loading import load_mission
from onboard.config.fleet import load_fleet
from sitl.monte_carlo import campaign_settings, process_chunks
from sitl.monte_carlo.batch_flight import fly
from sitl.monte_carlo.open_benchmark import scene_file, scene_plans

FAILING = """

def failing(memory, inputs):
    memory, thrust = law(memory, inputs)
    if memory > 300:
        raise ValueError("no more")
    return memory, thrust
"""

# they push each other towards the pillar
_PILLAR = """
{
  "schema": 1,
  "name": "pillar",
  "about": "Two vehicles change places beside a pillar.",
  "placing": {
    "type": "listed",
    "start_enu_m": [[-2.0, 0.0], [2.0, 0.0]],
    "goal_enu_m": [[2.0, 0.0], [-2.0, 0.0]]
  },
  "obstacles": [{"begin_enu_m": [0.0, 1.2], "radius_m": 0.25}],
  "set": {"delay_s": 0.1, "wind_m_s": 2.0}
}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What ``covey init --law`` writes."""
    made = tmp_path / "mine"
    assert cli.main(["init", str(made), "--law", "my_law"]) == 0
    return made


@pytest.mark.long
def test_the_templates_law_flies_the_mission_of_covey_init(folder, lockstep):
    flight = lockstep(load_fleet(str(folder / "fleet.toml")), folder=folder)
    verdict = flight.fly(load_mission(str(folder / "mission.toml")))
    assert verdict.passed, verdict.sentences
    assert all(shell.core.control.law_refusal == "" for shell in flight.agents.values())
    assert {shell.core.identity.law for shell in flight.agents.values()} == {"my_law:law"}


@pytest.mark.long
@pytest.mark.failsafe("own law refused, Covey's flies", step="flying")
def test_a_law_that_fails_in_flight_is_named_and_coveys_flies_on(folder, lockstep):
    path = folder / "my_law.py"
    path.write_text(path.read_text() + FAILING)
    flight = lockstep(
        load_fleet(str(folder / "fleet.toml")).with_law("my_law:failing"), folder=folder
    )
    verdict = flight.fly(load_mission(str(folder / "mission.toml")))
    assert verdict.closest.distance_m > 0.8
    assert (
        f"my_law:failing' (Covey's in its place on {', '.join(sorted(flight.agents))})"
        in verdict.summary
    )
    told = [event for event in flight.events if "own law" in event.sentence.lower()]
    assert {event.vehicle for event in told} == set(flight.agents)
    assert all("my_law:failing raised ValueError: no more" in event.sentence for event in told)


@pytest.mark.long
def test_a_campaign_flies_it_and_tells_of_each_flight_in_which_covey_took_over(folder):
    path = folder / "my_law.py"
    path.write_text(path.read_text() + FAILING)
    fleet_path = str(folder / "fleet.toml")
    for law, is_refused in (("my_law:law", False), ("my_law:failing", True)):
        setup = campaign_settings.setup_for(law=law, fleet_path=fleet_path)
        (record,) = [
            record
            for part in process_chunks.campaign(["swap2"], range(1), setup)
            for record in part
        ]
        assert record["law"] == law
        assert record["success"]
        assert not record["collision"]
        assert ("law_refused" in record) is is_refused


def test_the_templates_law_passes_beside_a_pillar(folder, monkeypatch):
    monkeypatch.chdir(folder)
    scene = scene_file.parsed(_PILLAR.encode(), "pillar.json")
    setup = scene_plans.setup(scene, law="my_law:law")
    (flown,) = fly([scene_plans.plan(scene, 0)], setup)
    assert flown.law_refusal == ""
    assert flown.outcome.is_success
    assert flown.outcome.min_separation_m > 0.8
    assert flown.outcome.min_clearance_m > 0.0


def test_the_check_says_that_the_file_brings_code_along(folder):
    findings = {finding.name: finding for finding in examine(str(folder / "fleet.toml"))[2]}
    assert findings["own law"].status == "warning"
    assert str(folder / "my_law.py") in findings["own law"].sentence


def test_init_refuses_a_name_that_python_could_not_import(tmp_path, capsys):
    assert cli.main(["init", str(tmp_path / "mine"), "--law", "my-law"]) == 2
    assert "'my-law'" in capsys.readouterr().err
    assert not (tmp_path / "mine").exists()


BREAKING = """
from onboard.types import Thrust


def sinking(memory, inputs):
    thrust = inputs.baseline.thrust_enu_m_s2
    memory = (memory or 0) + 1
    if memory > 200:
        return memory, (thrust.x, thrust.y, 5.0)
    return memory, inputs.baseline


def straying(memory, inputs):
    memory = (memory or 0) + 1
    if memory > 200:
        return memory, inputs.limited(50.0, 0.0)
    return memory, inputs.baseline
"""


@pytest.mark.failsafe("own law refused, Covey's flies", step="flying")
@pytest.mark.parametrize(
    ("name", "words"),
    [("sinking", "sink too fast to stop above the ground"), ("straying", "cross the geofence")],
)
def test_coveys_law_flies_on_when_a_law_flies_a_vehicle_into_something(
    folder, lockstep, name, words
):
    path = folder / "my_law.py"
    path.write_text(path.read_text() + BREAKING)
    fleet = load_fleet(str(folder / "fleet.toml")).with_law(f"my_law:{name}")
    fleet = replace(fleet, vehicles={"mav1": fleet.vehicles["mav1"]}, formations={})
    flight = lockstep(fleet, folder=folder)
    flight.takeoff(1.5)
    flight.run(15.0)

    [told] = [event.sentence for event in flight.events if event.code == "own-law-refused"]
    assert words in told
    assert not flight.touchdowns or flight.touchdowns[-1].speed_m_s < 0.8
    truth = flight.state.vehicles["mav1"].truth
    _, east_m = fleet.fleet.geofence_m.x
    assert truth.position_enu_m[0] < east_m + 2.5
