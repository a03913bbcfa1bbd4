"""The campaign behind ``covey evidence``: what it breaks, and that it can be flown again."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import pytest

from groundstation.evidence.kept_flights import (
    NOTHING,
    FlightCase,
    FlownCase,
    KeptFlights,
    digest,
)
from groundstation.evidence.matrix import SHOWN, WRONG, matrix
from onboard.config.fleet import ConfigError, FleetConfig, load_fleet
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation
from sitl.lockstep.campaign import broken_flight, evidence_campaign
from sitl.lockstep.campaign.broken_flight import injection_of
from sitl.lockstep.campaign.evidence_campaign import (
    Campaign,
    broken_cases,
    fly_campaign,
    possible_victims,
    refuse_strong_wind,
    undisturbed_cases,
)
from sitl.lockstep.campaign.extent import Extent
from sitl.lockstep.campaign.judge import Judge
from sitl.lockstep.flight import Lockstep
from tests.groundstation.evidence.campaigns import flown

FAULT = "mocap lost for good"
HOP = """\
schema = 1
fleet = "paper"

[[step]]
do = "takeoff"
height_m = 0.8

[[step]]
do = "wait"
duration_s = 6

[[step]]
do = "land"
"""


@pytest.fixture
def hop(tmp_path: Path) -> Campaign:
    """A hover of three, with one fault."""
    mission = tmp_path / "hop.toml"
    mission.write_text(HOP, encoding="utf-8")
    return Campaign(
        fleet_path="paper", mission_path=str(mission), wind_m_s=2.0, rounds=1, only=FAULT
    )


def _fly(campaign: Campaign, folder: Path) -> tuple[list[FlownCase], list[str]]:
    said: list[str] = []
    kept = KeptFlights(folder / "flights.jsonl", {"of": "a test"})
    return fly_campaign(campaign, kept, jobs=1, say=said.append), said


def test_each_round_breaks_everything_once_and_is_the_same_again(
    hop: Campaign, hop_mission
) -> None:
    whole = hop._replace(only="", rounds=2)
    cases = list(broken_cases(whole, hop_mission, flown()))
    assert cases == list(broken_cases(whole, hop_mission, flown()))
    names = [case.fault for case in cases if case.round == 0]
    assert len(names) == len(set(names)) > 50
    assert not any("satellites" in name for name in names)
    assert len({case.seed for case in [*undisturbed_cases(whole), *cases]}) == len(cases) + 2
    assert all(3.0 <= case.at_s <= 20.0 for case in cases)
    assert len({case.at_s for case in cases}) > 0.9 * len(cases)


@pytest.fixture
def hop_mission(hop: Campaign):
    """The mission itself."""
    from groundstation.mission_files.loading import load_mission

    return load_mission(hop.mission_path)


def test_only_what_a_fleet_has_can_break(paper: FleetConfig) -> None:
    satellites = load_fleet("px4-sitl")
    by_vision = msgspec.structs.replace(
        satellites,
        vehicles={
            name: msgspec.structs.replace(vehicle, px4_position="vision")
            for name, vehicle in satellites.vehicles.items()
        },
    )
    alone = msgspec.structs.replace(paper, vehicles={"mav0": paper.vehicles["mav0"]}, formations={})
    assert possible_victims(paper, injection_of("satellites lost")) == []
    assert possible_victims(satellites, injection_of("satellites lost")) == [*satellites.vehicles]
    assert possible_victims(satellites, injection_of(FAULT)) == []
    assert possible_victims(by_vision, injection_of("satellites lost")) == []
    assert possible_victims(by_vision, injection_of("odometry jumps for good")) == [*paper.vehicles]
    assert possible_victims(paper, injection_of("odometry jumps for good")) == []
    # PX4's Hold needs a place on Earth
    assert possible_victims(by_vision, injection_of("a pilot takes over")) == []
    assert possible_victims(by_vision, injection_of("a pilot lands")) == [*paper.vehicles]
    assert possible_victims(alone, injection_of("mocap swaps two")) == []
    assert possible_victims(alone, injection_of("motor dead")) == ["mav0"]


@pytest.mark.parametrize(
    "fault",
    ["cut off from all but the mocap", "all cut apart, mocap stays", "ground lost for good"],
)
def test_what_only_a_vehicle_with_neighbours_can_notice_is_not_flown_with_one_alone(
    paper: FleetConfig, fault: str
) -> None:
    alone = msgspec.structs.replace(paper, vehicles={"mav0": paper.vehicles["mav0"]}, formations={})
    assert possible_victims(alone, injection_of(fault)) == []
    assert possible_victims(paper, injection_of(fault)) == [*paper.vehicles]


@pytest.mark.parametrize("wind_m_s", [-1.0, float("nan"), 9.0])
def test_a_wind_in_which_the_fleet_does_not_set_out_is_refused(
    paper: FleetConfig, wind_m_s: float
) -> None:
    with pytest.raises(ConfigError, match="--wind is"):
        refuse_strong_wind(paper, wind_m_s)


def test_the_gusts_of_a_wind_have_to_fit_below_the_limit_too(paper: FleetConfig) -> None:
    limited = msgspec.structs.replace(
        paper, fleet=msgspec.structs.replace(paper.fleet, max_wind_m_s=3.0)
    )
    with pytest.raises(ConfigError, match="or a fleet whose max_wind_m_s is higher"):
        refuse_strong_wind(limited, 3.0)
    refuse_strong_wind(limited, 2.6)


@pytest.mark.long
def test_a_campaign_has_the_same_digest_again_and_flies_nothing_that_it_has(
    hop: Campaign, tmp_path: Path
) -> None:
    first = tmp_path / "first"
    second = tmp_path / "second"
    first.mkdir()
    second.mkdir()
    flights, said = _fly(hop, first)
    assert len(flights) == len(said) + 1 == 3
    assert all(one.is_right for one in flights)
    assert next(row for row in matrix(flights, {}) if row.key == "tracking-lost").status == SHOWN

    assert digest(_fly(hop, second)[0]) == digest(flights)
    again, said = _fly(hop, first)
    assert (again, said) == (flights, [])


def test_vehicles_may_be_named_like_what_the_campaign_adds_to_the_bus(
    tmp_path: Path, lockstep: Callable[..., Lockstep]
) -> None:
    text = Path("configs/fleets/paper.toml").read_text(encoding="utf-8")
    file = tmp_path / "fleet.toml"
    file.write_text(text.replace("mav0", "judge").replace("mav1", "liar"), encoding="utf-8")
    flight = lockstep(load_fleet(file))

    injection = injection_of("nonsense on the bus")
    Judge(flight, injection, "judge", silenced=())
    injection.inject(flight, "judge")
    for name in ("judge", "liar"):
        assert flight.bus.nodes[name] is flight.agents[name].node
    assert len(flight.bus.nodes) == len(flight.agents) + 4  # ground, emulator and the two


def test_a_flight_in_which_the_own_law_was_refused_is_wrong(
    paper: FleetConfig, lockstep: Callable[..., Lockstep]
) -> None:
    flight = lockstep(paper)
    judge = Judge(flight, injection_of(FAULT), "mav0", silenced=())
    flight.agents["mav1"].core.control.law_refusal = "is slow"
    flight.run(0.1)
    judge.finish()
    assert judge.wrong == ["mav1: covey was refused, and Covey's law flew in its place"]


def test_a_flight_that_cannot_begin_is_wrong_with_its_error(
    hop: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_args: object, **_options: object) -> None:
        raise ZeroDivisionError("in the constructor")

    monkeypatch.setattr(broken_flight, "Lockstep", refuse)
    case = FlightCase(fault=FAULT, round=0, victim="mav0", at_s=9.0)
    flight = evidence_campaign.fly_case(hop.fleet_path, hop.mission_path, case)
    assert flight.wrong == ("ends with ZeroDivisionError: in the constructor",)
    assert not flight.took_off


@pytest.fixture
def idle(tmp_path: Path) -> str:
    """Path of a mission that ends as soon as its vehicles are ready."""
    mission = tmp_path / "idle.py"
    mission.write_text("async def mission(fleet):\n    pass\n", encoding="utf-8")
    return str(mission)


@pytest.mark.parametrize("is_alone", [True, False])
def test_a_vehicle_that_flies_beside_parked_ones_is_no_pair_in_the_air(
    tmp_path: Path, is_alone: bool
) -> None:
    text = HOP
    if is_alone:
        text = text.replace("height_m", 'vehicles = ["mav0"]\nheight_m')
        text = text.replace('"land"', '"land"\nvehicles = ["mav0"]')
    mission = tmp_path / "hop.toml"
    mission.write_text(text, encoding="utf-8")
    case = FlightCase(fault=NOTHING, round=0)
    flight = evidence_campaign.fly_case("paper", str(mission), case)
    assert (flight.took_off, flight.wrong) == (True, ())
    assert flight.smallest_m is not None
    assert flight.had_pair is not is_alone


def test_a_flight_whose_fault_was_never_injected_is_wrong(idle: str) -> None:
    case = FlightCase(fault=FAULT, round=0, victim="mav0", at_s=90.5)
    flight = evidence_campaign.fly_case("paper", idle, case)
    assert flight.wrong == ("the fault at 90.5 s was not injected: the flight ended before it",)


def test_ctrl_c_ends_the_campaign_and_keeps_no_flight_that_is_not_whole(
    idle: str, hop: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt_soon(_extent: Extent, flight: Lockstep) -> None:
        flight.at(0.5, lambda: signal.raise_signal(signal.SIGINT))

    monkeypatch.setattr(Extent, "watch", interrupt_soon)
    kept = KeptFlights(tmp_path / "flights.jsonl", {"of": "a test"})
    with pytest.raises(KeyboardInterrupt):
        fly_campaign(hop._replace(mission_path=idle), kept, jobs=1, say=print)
    assert kept.flown == {}


def test_a_flight_behind_a_slow_one_is_kept_at_once_and_reported_in_its_turn(
    hop: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept_broken = threading.Event()

    class Kept(KeptFlights):
        def keep(self, flight: FlownCase) -> None:
            super().keep(flight)
            if flight.case.fault == FAULT:
                kept_broken.set()

    def fly_case(_fleet: str, _mission: str, case: FlightCase) -> FlownCase:
        is_slow = case.fault == NOTHING and case.round == 1
        if is_slow:
            assert kept_broken.wait(timeout=2.0)
        return msgspec.structs.replace(flown(), case=case)

    monkeypatch.setattr(evidence_campaign, "fly_case", fly_case)
    monkeypatch.setattr(evidence_campaign, "worker_pool", ThreadPoolExecutor)
    kept = Kept(tmp_path / "flights.jsonl", {"of": "a test"})
    said: list[str] = []
    flights = fly_campaign(hop, kept, jobs=2, say=said.append)

    assert [flight.case.fault for flight in flights] == [NOTHING, NOTHING, FAULT]
    assert [flight.case.fault for flight in kept.flown.values()] == [NOTHING, FAULT, NOTHING]
    assert [line.split(" (")[0].split(", ")[0] for line in said] == [
        "2 of 3  nothing",
        f"3 of 3  {FAULT}",
    ]


@pytest.mark.long
def test_a_row_taken_out_of_the_failsafe_table_shows_red_in_its_flights(
    hop: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for condition in (Condition.POSITION_LOST, Condition.POSITION_LOST_LONG):
        monkeypatch.setitem(TABLE, (Situation.FLYING, condition), Action.GO_ON)
    flights, _ = _fly(hop, tmp_path)
    row = next(row for row in matrix(flights, {}) if row.key == "tracking-lost")
    assert row.status == WRONG
    assert row.wrong_flights == 1
    assert any("landing is asked for" in reason for reason in row.reasons)


@pytest.mark.long
def test_a_mission_that_does_not_take_off_gives_no_evidence(
    hop: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from sitl.lockstep.flight import Lockstep

    async def nothing(*_: object, **__: object) -> None:
        raise RuntimeError("no")

    monkeypatch.setattr(Lockstep, "_fly", nothing)
    with pytest.raises(ConfigError, match="does not take off although nothing fails"):
        _fly(hop, tmp_path)
