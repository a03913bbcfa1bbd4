"""Where a fleet stands in the map of the law: refused, promised, or not known, in words."""

import pytest

from onboard.config.fleet import ConfigError, load_fleet
from onboard.config.radio import RadioConfig
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility.law_map import LawMap, MapCell, law_map_of, map_finding, shipped
from tests.onboard.feasibility.test_fleet_checks import ROOT, fleet_with

MOCAP = ACCURACIES["mocap"]


def cell(
    vehicles=8,
    speed=1.0,
    delay=0.05,
    loss=0.1,
    *,
    errors="mocap",
    flights=504,
    below=0,
    margin=0.12,
):
    return MapCell(
        errors=errors,
        vehicles=vehicles,
        speed_m_s=speed,
        delay_s=delay,
        loss_frac=loss,
        margin_m=margin,
        flights=flights,
        below=below,
        arrived=flights,
        worst_m=0.86,
    )


def found(*cells, changes=None, accuracy=MOCAP, law=None):
    fleet = fleet_with(changes)
    return map_finding(
        fleet,
        accuracy,
        LawMap(version="a", safety_distance_m=0.8, lag_s=0.15, law=law or {}, cells=cells),
    )


def test_a_fleet_within_a_cell_that_holds_is_promised_that():
    finding = found(cell())
    assert finding.status == "ok"
    assert "0 of 504 flights came below 0.80 m with 8 vehicles" in finding.sentence


@pytest.mark.parametrize(
    "harder",
    [
        {"vehicles": 2},
        {"speed": 0.5},
        {"delay": 0.02},
        {"loss": 0.0},
        {"flights": 21},
        {"margin": 0.3},
    ],
)
def test_nothing_is_promised_by_an_easier_cell_by_a_screening_or_by_a_larger_margin(harder):
    finding = found(cell(**harder), cell(3, 1.0, 0.02, 0.0))
    # only the margin is the owner's to change
    assert finding.status == ("warning" if "margin" in harder else "note")
    assert "no cell of the map of the law promises that" in finding.sentence
    assert "Nearest cell that holds: " in finding.remedy


@pytest.mark.parametrize(
    "easier", [{"vehicles": 3}, {"vehicles": 2, "speed": 0.5, "delay": 0.02, "loss": 0.0}]
)
def test_a_fleet_is_refused_where_a_cell_that_is_no_harder_has_failed_even_if_a_harder_one_holds(
    easier,
):
    finding = found(cell(16, 4.0, 0.3, 0.3), cell(**{"delay": 0.02, **easier}, flights=21, below=2))
    assert finding.status == "refused"
    assert "2 of 21 flights" in finding.sentence
    assert "Nearest cell that holds: 16 vehicles" in finding.remedy


def test_a_harder_cell_that_failed_refuses_nothing():
    failed = [
        cell(16, below=1),
        cell(3, speed=2.0, below=1),
        cell(3, loss=0.3, below=1),
        cell(3, delay=0.1, below=1),
    ]
    assert found(cell(), *failed).status == "ok"


def test_what_the_fleet_expects_of_its_radio_moves_it_in_the_map():
    expects = {"radio.expected_delay_s": 0.2, "radio.expected_loss_frac": 0.3}
    assert found(cell(), changes=expects).status == "note"
    assert found(cell(), cell(delay=0.2, loss=0.3), changes=expects).status == "ok"


def test_satellites_and_vision_are_not_promised_by_mocap_but_mocap_by_vision():
    assert found(cell(), accuracy=ACCURACIES["vision"]).status == "note"
    assert found(cell(errors="vision")).status == "ok"
    assert found(cell(3, delay=0.02, below=1), accuracy=ACCURACIES["gps"]).status == "refused"


def test_another_law_or_a_slower_vehicle_is_named_as_the_reason():
    other = found(cell(), law={"mocap": {"kappa_1_1_s": 3.0}})
    assert other.status == "note"
    assert "law.kappa_1_1_s = 3.0 (here 4.0)" in other.sentence
    slow = map_finding(
        load_fleet("paper").with_law("covey"),
        MOCAP,
        LawMap(version="a", safety_distance_m=0.8, lag_s=0.15, law={}, cells=(cell(margin=0.1),)),
    )
    assert "a command 0.15 s later" in slow.sentence


@pytest.mark.parametrize("distance_m", [0.6, 1.0])
def test_another_safety_distance_is_named_as_the_reason(distance_m):
    other = found(cell(), changes={"fleet.safety_distance_m": distance_m})
    assert other.status == "note"
    assert f"fleet.safety_distance_m = 0.8 (here {distance_m})" in other.sentence


def test_heights_that_count_are_named_as_the_reason():
    other = found(cell(), changes={"fleet.vertical_separation_m": 1.2})
    assert other.status == "note"
    assert "no fleet.vertical_separation_m (here 1.2)" in other.sentence


def test_a_harder_cell_that_holds_is_named_before_an_easier_one_that_is_nearer():
    slow = map_finding(
        load_fleet("sih").with_law("covey"),
        MOCAP,
        LawMap(
            version="a",
            safety_distance_m=0.8,
            lag_s=0.0,
            law={},
            cells=(cell(3, delay=0.02), cell(16, margin=0.1)),
        ),
    )
    assert slow.status == "note"
    assert "Nearest cell that holds: 16 vehicles" in slow.remedy


def test_without_any_cell_that_holds_the_sentence_says_so():
    assert "No cell of the map holds." in found(cell(flights=21)).sentence


def test_map_of_another_schema_is_refused_in_words():
    with pytest.raises(ConfigError, match="schema 7"):
        law_map_of({"schema": 7})


def test_shipped_map_promises_the_usual_radio_to_the_example_fleet_and_refuses_nothing_there():
    law_map = shipped()
    usual = RadioConfig()
    assert len(law_map.cells) > 100
    finding = map_finding(load_fleet("sih"), MOCAP, law_map)
    assert (finding.status, usual.expected_delay_s, usual.expected_loss_frac) == ("ok", 0.04, 0.1)


def test_the_folder_of_an_own_law_that_does_not_fly_takes_no_promise_away():
    changes = {"law.folder": str(ROOT / "configs"), "law.allow_own_law_on_real_vehicles": True}
    assert map_finding(fleet_with(changes), MOCAP, shipped()).status == "ok"


def test_a_radio_that_is_late_makes_a_neighbour_silent_later_and_the_usual_one_does_not():
    assert RadioConfig().lateness_s == 0.0
    late = RadioConfig(expected_delay_s=0.3, expected_loss_frac=0.3)
    assert late.state_age_s(0.02) == pytest.approx(0.38)
    assert late.lateness_s == pytest.approx(0.30)
    assert RadioConfig(expected_delay_s=2.0).lateness_s == 0.45
    assert RadioConfig(expected_loss_frac=0.0).state_age_s(0.02) == pytest.approx(0.06)
