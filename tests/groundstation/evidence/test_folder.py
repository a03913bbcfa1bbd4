"""The folder: a page that says what is not shown, a picture, GeoJSON, figures of two machines."""

from __future__ import annotations

import json
import re

import msgspec
import numpy as np
import pytest

from groundstation.evidence import evidence_page
from groundstation.evidence.evidence_comparison import compared
from groundstation.evidence.evidence_summary import read_evidence
from groundstation.evidence.folder import OtherMachine, write_folder
from groundstation.evidence.hazards import HAZARDS, NOT_SHOWN
from onboard.confidence_intervals import upper_bound
from onboard.config.fleet import ConfigError
from tests.groundstation.evidence.campaigns import evidence, flown


def written(tmp_path, fleet, flights, other=None):
    whole = evidence(fleet, flights)
    agreements = write_folder(tmp_path, whole, fleet=fleet, flights=flights, other=other)
    return whole, agreements, (tmp_path / "evidence.html").read_text(encoding="utf-8")


def test_the_page_has_every_question_and_what_is_not_shown_in_one_table(tmp_path, paper) -> None:
    bad = flown("motor dead", wrong=("mav0 <b>falls</b> & burns",))
    whole, _, page = written(tmp_path, paper, [flown(), bad])
    assert whole.is_wrong
    table = page.partition("<h2>What was asked")[2].partition("</table>")[0]
    assert table.count("<tr class=") == len(HAZARDS) + len(NOT_SHOWN)
    for word in ("Hardware", "Flight termination", "Pilot and crew", "Real wind and weather"):
        assert word in table
    assert "mav0 &lt;b&gt;falls&lt;/b&gt; &amp; burns" in page
    assert "a &lt;machine&gt;" in page
    assert "<script" not in page


@pytest.mark.parametrize(("has_keys", "word"), [(True, "locked"), (False, "open")])
def test_the_page_says_whether_the_bus_is_locked(paper, has_keys: bool, word: str) -> None:
    whole = evidence(paper, [flown()])
    made_by = msgspec.structs.replace(whole.provenance, has_keys=has_keys)
    whole = msgspec.structs.replace(whole, provenance=made_by)
    assert f"the bus of this fleet file is {word}" in evidence_page.page(whole, b"", [], "")


@pytest.mark.long
def test_a_row_of_which_not_all_faults_were_flown_says_so(tmp_path, paper) -> None:
    _, _, page = written(tmp_path, paper, [flown("motor dead"), flown("a pilot lands")])
    assert "evidence for, in part: 2 faults not flown" in page  # of three of propulsion
    assert "evidence for, in part: 1 fault not flown" in page  # of two of the pilot


def test_a_row_of_few_flights_says_so_and_is_not_green(tmp_path, paper) -> None:
    _, _, look = written(tmp_path, paper, [flown()])
    assert "<tr class='shown wide'>" in look
    assert "evidence for; 1 flight only" in look
    assert "2 rest on so few flights that 20 % of such flights or more may still be wrong" in look

    _, _, long = written(tmp_path, paper, [flown(number=number) for number in range(20)])
    assert "<tr class='shown'>" in long
    assert "flights only" not in long


def test_nothing_of_it_says_that_a_regulation_is_met(tmp_path, paper) -> None:
    written(tmp_path, paper, [flown()])
    for name in ("evidence.html", "evidence.json"):
        text = (tmp_path / name).read_text(encoding="utf-8").lower()
        assert not re.search(r"complian|compliant|complies|certif(y|ied)|approved", text)


def test_the_files_can_be_read_again(tmp_path, paper) -> None:
    whole, _, _ = written(tmp_path, paper, [flown()])
    assert read_evidence(tmp_path) == whole
    shapes = json.loads((tmp_path / "geography.geojson").read_text())
    names = [feature["properties"]["name"] for feature in shapes["features"]]
    assert names == ["flight geography", "contingency volume", "ground risk buffer"]
    assert (tmp_path / "volumes.png").read_bytes().startswith(b"\x89PNG")


def test_evidence_of_another_schema_is_refused(tmp_path, paper) -> None:
    later = msgspec.structs.replace(evidence(paper, [flown()]), schema=99)
    (tmp_path / "evidence.json").write_bytes(msgspec.json.encode(later))
    with pytest.raises(ConfigError, match="has schema 99"):
        read_evidence(tmp_path)


def test_evidence_without_a_geography_is_refused(tmp_path, paper) -> None:
    whole = evidence(paper, [flown()])
    empty = msgspec.structs.replace(whole, volumes=whole.volumes._replace(geography=()))
    (tmp_path / "evidence.json").write_bytes(msgspec.json.encode(empty))
    with pytest.raises(ConfigError, match="without corners"):
        read_evidence(tmp_path)


def agreements(fleet, here, there):
    return compared(
        evidence(fleet, here),
        evidence(fleet, there),
        flights_here=here,
        flights_there=there,
        half_body_m=0.5 * fleet.fleet.body_diameter_m,
    )


def broken(count=40, **changes):
    return [flown(), *(flown("motor dead", number, **changes) for number in range(count))]


def results(fleet, here, there):
    return {one.figure: one.result for one in agreements(fleet, here, there)}


def test_figures_of_another_machine_are_put_beside_and_both_are_named(tmp_path, paper) -> None:
    flights = broken()
    machine = msgspec.structs.replace(
        evidence(paper, []).provenance, machine={"processor": "the other one"}
    )
    same = msgspec.structs.replace(evidence(paper, flights), provenance=machine)
    _, figures, page = written(tmp_path, paper, flights, other=OtherMachine(same, flights))
    assert figures
    assert all(one.is_within for one in figures)
    assert "the other one" in page
    assert "a &lt;machine&gt;" in page


def test_a_figure_outside_of_the_other_machines_interval_is_found(paper) -> None:
    found = results(paper, broken(), broken(wrong=("falls on mav1",)))
    outside = {figure for figure, result in found.items() if result == "outside"}
    assert outside == {"propulsion", "one-among-others"}


def test_a_row_that_only_one_machine_has_flown_is_not_comparable(paper) -> None:
    (row,) = [one for one in agreements(paper, broken(), [flown()]) if one.figure == "propulsion"]
    assert row == ("propulsion", "0 of 40", "not flown", "not comparable")
    assert not row.is_within
    assert results(paper, [flown()], broken())["propulsion"] == "not comparable"


BEYOND = "flights beyond the other's contingency volume"


def test_flights_far_beyond_the_other_machines_volume_are_found(paper) -> None:
    wide = ((-9.0, 0.0), (2.0, 0.0), (2.0, 2.0))
    found = results(paper, broken(hull_m=wide), broken())
    assert [figure for figure, result in found.items() if result != "within"] == [BEYOND]


def test_volumes_at_another_place_do_not_agree(paper) -> None:
    elsewhere = ((100.0, 0.0), (102.0, 0.0), (102.0, 2.0), (100.0, 2.0))
    away = [msgspec.structs.replace(flight, hull_m=elsewhere) for flight in broken()]
    assert results(paper, broken(), away)[BEYOND] == "outside"


def test_volumes_of_another_height_do_not_agree(paper) -> None:
    found = agreements(paper, broken(highest_m=50.0), broken())[-1]
    assert (found.here, found.there, found.result) == ("40 of 41", "0 of 41", "outside")


def test_few_flights_beyond_the_other_volume_are_chance(paper) -> None:
    one_higher = [*broken(39), flown("motor dead", 39, highest_m=1.2)]
    found = agreements(paper, one_higher, broken())[-1]
    assert (found.here, found.result) == ("1 of 41", "within")


def test_a_flight_is_beyond_the_other_volume_as_soon_as_half_a_body_is(paper) -> None:
    half_body_m = 0.5 * paper.fleet.body_diameter_m
    wide = ((-3.0, 0.0), (2.0, 0.0), (2.0, 2.0))
    wider = ((-3.0 - 0.5 * half_body_m, 0.0), (2.0, 0.0), (2.0, 2.0))

    same = agreements(paper, broken(hull_m=wide), broken(hull_m=wide))[-1]
    assert same.here == same.there == "0 of 41"
    beyond = agreements(paper, broken(hull_m=wider), broken(hull_m=wide))[-1]
    assert (beyond.here, beyond.there) == ("40 of 41", "0 of 41")


def test_the_share_beyond_the_volume_is_that_for_the_maxima_of_width_and_height(paper) -> None:
    whole = evidence(paper, [flown(number=number) for number in range(220)])
    assert "fewer than 2.1 % go beyond it" in evidence_page.page(whole, b"", [], "")

    # campaigns in which width and height do not depend on each other
    rng = np.random.default_rng(1)
    flown_m = rng.random((4000, 220, 2)).max(axis=1)
    beyond_share = 1.0 - flown_m[:, 0] * flown_m[:, 1]
    assert np.mean(beyond_share < upper_bound(1, 220)) == pytest.approx(0.95, abs=0.01)
