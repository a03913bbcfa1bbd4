"""``make bench-law`` flies everybody, writes tables that say what happened, and the pages point at
what exists.
"""

import math
import re
from pathlib import Path

import pytest

from groundstation import cli
from onboard.control import pipeline
from sitl.monte_carlo import batch_flight, campaign_settings, scenarios
from tests.bench.__main__ import main as run_benchmark
from tests.bench.peers import arena, bench, pages
from tests.bench.peers.ablation import VARIANTS
from tests.bench.peers.contestants import COVEY, PEERS, named, same
from tests.bench.peers.report import Outcome, summary, table

ROOT = Path(__file__).parents[3]
PAGES = ["law.md", "law-measured.md"]


def rows_of(markdown: str) -> dict[str, list[str]]:
    """The first table that has a column of separations: first cell of each line, and the others."""
    lines = [line for line in markdown.splitlines() if line.startswith("|")]
    start = next(k for k, line in enumerate(lines) if "worst m" in line)
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[start + 2 :]]
    width = len(lines[start].strip("|").split("|"))
    return {row[0]: row[1:] for row in cells if len(row) == width}


# half a minute on a slow machine; the laws themselves are tested beside their code
@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_quick_bench_flies_everybody_and_its_table_says_who_kept_the_distance(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(bench, "QUICK", ("swap4",))
    (tmp_path / "law-measured.md").write_text(
        "before\n<!-- bench: methods -->\nformer table\n<!-- end -->\nafter\n"
    )

    assert bench.main(["--quick", "--seeds", "0:1", "--jobs", "1", "--out", str(tmp_path)]) == 0

    page = (tmp_path / "law-measured.md").read_text()
    assert "former table" not in page
    assert page.startswith("before")
    assert page.endswith("after\n")

    rows = rows_of(page)
    assert list(rows) == [contestant.title for contestant in PEERS.values()]
    flights, success, below, _, worst = rows["Covey"][:5]
    assert (flights, success) == ("1", "100 %")
    assert below.startswith("0 %")
    assert float(worst) > 0.8
    assert rows["no avoidance"][2].startswith("100 %")
    assert 'make bench-law ARGS="--quick --seeds 0:1 --out docs"' in page

    for name in re.findall(r"\]\((figures/[^)]+)\)", page):
        assert (tmp_path / name).stat().st_size > 10_000
    assert "Covey" in capsys.readouterr().out


@pytest.mark.parametrize(
    "contestant", [*VARIANTS.values(), *PEERS.values()], ids=lambda one: one.title
)
def test_what_a_contestant_sets_exists(contestant):
    fleet = campaign_settings.setup_for(law=contestant.built_in, changes=contestant.sets).fleet(4)
    params = pipeline.pipeline_params(fleet, "v0")
    changed = contestant.change(params)
    is_alike = changed == params and not contestant.sets and contestant.built_in == COVEY.built_in
    assert not is_alike or contestant.step or contestant.hear is not same or contestant is COVEY


@pytest.mark.long
def test_coveys_law_through_the_door_of_own_laws_flies_as_it_does_without():
    """Nothing that it needs is missing, and who flies through it is flown as Covey's law is."""
    plans = [scenarios.plan("swap2", 3)]
    setup = campaign_settings.setup_for()
    (plain,) = batch_flight.fly(plans, setup)
    (ours,) = batch_flight.fly(
        plans, campaign_settings.setup_for(law="tests.bench.peers.laws:covey")
    )
    assert ours.law_refusal == ""
    assert ours.outcome.min_separation_m == pytest.approx(plain.outcome.min_separation_m, abs=1e-6)
    assert ours.outcome.makespan_s == plain.outcome.makespan_s


@pytest.mark.long
def test_a_law_of_somebodys_own_flies_in_the_bench_and_an_unknown_one_is_refused_in_words(capsys):
    (flown,) = arena.fly(named("tests.bench.peers.laws:potential"), "swap2", [0]).outcomes
    (expected,) = arena.fly(PEERS["potential"], "swap2", [0]).outcomes
    assert flown == expected
    assert run_benchmark(["law", "--law", "nowhere:law"]) == 2
    assert "Put nowhere.py there" in capsys.readouterr().err
    assert run_benchmark(["law", "--law", "paper"]) == 2
    assert "--law is 'paper'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "name", ["orca", "cells", "certificate", "robust_certificate", "potential"]
)
def test_a_peer_has_a_name_that_a_fleet_file_can_give(name):
    law = campaign_settings.setup_for(law=f"tests.bench.peers.laws:{name}").fleet(2).own_law
    assert law is not None
    assert law.source_hash


def outcome(separation_m, ratio=1.2):
    is_there = math.isfinite(ratio)
    return Outcome(
        scenario="swap4",
        seed=0,
        success=is_there,
        min_separation_m=separation_m,
        violation_s=0.1 if separation_m < 0.8 else 0.0,
        collision=separation_m < 0.5,
        ratio=ratio,
        relaxed_share=0,
        slew_m_s3=9,
        max_speed_m_s=1,
    )


def test_a_summary_counts_what_happened_and_takes_the_ratio_of_those_that_arrived():
    found = summary([outcome(0.9), outcome(0.7, 1.4), outcome(0.4, math.inf), outcome(1.0)], 3.0)
    assert (found.flights, found.successes, found.violations, found.collisions) == (4, 3, 2, 1)
    assert found.worst_m == 0.4
    assert found.ratio == pytest.approx((1.2 + 1.4 + 1.2) / 3)
    assert "| a | 4 | 75 % | 50 % (6.8-93) | 1 | 0.400 |" in table({"a": found})


@pytest.mark.long  # ten seconds of interpreted flights
def test_a_bench_over_delays_goes_on_from_the_file_that_it_kept(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(bench, "QUICK", ("swap2",))
    monkeypatch.setattr(bench, "PEERS", {key: PEERS[key] for key in ("covey", "off")})
    words = [
        "--quick",
        "--seeds",
        "0:1",
        "--jobs",
        "1",
        "--delays",
        "0.04,0.3",
        "--out",
        str(tmp_path),
    ]
    words += ["--keep", str(tmp_path / "bench.jsonl")]
    (tmp_path / "law-measured.md").write_text("<!-- bench: delay -->\n<!-- end -->\n")
    assert bench.main(words) == 0
    page = (tmp_path / "law-measured.md").read_text()
    assert "| method | 40 ms | 300 ms |" in page
    assert "| Covey | 100 % · 0 %" in page
    assert "| no avoidance | 100 % · 100 %" in page
    monkeypatch.setattr(bench, "fly", lambda cell: pytest.fail(f"{cell} was flown twice"))
    assert bench.main(words) == 0
    assert (tmp_path / "law-measured.md").read_text() == page
    capsys.readouterr()


def test_a_section_is_written_into_a_folder_that_has_no_page_yet(tmp_path):
    page = tmp_path / pages.MEASURED
    pages.write_section(page, "delay", "first")
    pages.write_section(page, "methods", "second")
    pages.write_section(page, "delay", "third")
    assert page.read_text() == (
        "<!-- bench: delay -->\nthird\n<!-- end -->\n"
        "<!-- bench: methods -->\nsecond\n<!-- end -->\n"
    )


def test_wrong_delays_are_refused_in_words(capsys):
    assert run_benchmark(["law", "--delays", "0.1,soon"]) == 2
    assert "--delays is '0.1,soon'" in capsys.readouterr().err


def test_wrong_seeds_are_refused_in_words(capsys):
    assert run_benchmark(["law", "--seeds", "9:3"]) == 2
    assert "--seeds is '9:3'" in capsys.readouterr().err


def test_the_old_command_names_the_new_one(capsys):
    assert cli.main(["bench", "law", "--seeds", "0:3"]) == 2
    assert 'make bench-law ARGS="--seeds 0:3"' in capsys.readouterr().err


@pytest.mark.parametrize("name", PAGES)
def test_every_link_and_figure_of_the_law_pages_exists(name):
    page = ROOT / "docs" / name
    targets = re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8"))
    assert targets
    for target in targets:
        assert (page.parent / target).exists(), (
            f"docs/{name} points at {target}, which is not there"
        )


@pytest.mark.parametrize("block", ["methods", "ablation"])
def test_the_tables_of_the_measured_law_are_filled_in(block):
    text = (ROOT / "docs/law-measured.md").read_text(encoding="utf-8")
    filled = text.partition(f"<!-- bench: {block} -->")[2].partition("<!-- end -->")[0]
    assert "Written by `make bench-law" in filled
    assert "| **Covey**" in filled or "| Covey |" in filled


def test_a_page_without_the_place_for_a_table_stays_as_it_is(tmp_path):
    page = tmp_path / "law.md"
    page.write_text("nothing here\n")
    pages.insert(page, "comparison", "table")
    assert page.read_text() == "nothing here\n"
