"""The verdicts of the long benchmarks can say no; they themselves are run by hand, on a quiet
machine.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from groundstation.missions.api import OrderFailed
from groundstation.orders.intents import Hold
from groundstation.processes.supervisor import agent_command, leaves_room
from onboard.config.fleet import fleet_from_mapping
from tests.bench import agents as bench_agents
from tests.bench import fixture
from tests.bench import soak as bench_soak
from tests.bench.agents import AgentCost, Result
from tests.bench.process_usage import usage
from tests.bench.soak import LateTick, Samples, Soak, Watcher, draw

AGENT = AgentCost(
    "mav0",
    p50_ms=20.0,
    p99_ms=21.0,
    max_ms=30.0,
    late_ticks=0,
    cpu_pct=10.0,
    rss_mib=70.0,
    ticks=9,
    followed=9,
)


def result(*agents: AgentCost) -> Result:
    return Result(
        agents=agents,
        seconds=30.0,
        emulator_cpu_pct=20.0,
        ground_cpu_pct=10.0,
        messages_per_s=500.0,
        tick_cpu_ms=2.0,
        with_precedence=len(agents),
    )


@pytest.mark.parametrize(
    ("spoilt", "words"),
    [
        (replace(AGENT, p99_ms=25.5), "p99 25.5 ms"),
        (replace(AGENT, p99_ms=float("nan")), "p99 nan"),
        (replace(AGENT, cpu_pct=15.2), "15.2 % of a core"),
        (replace(AGENT, rss_mib=121.0), "121 MiB"),
    ],
)
def test_one_agent_that_is_not_as_asked_is_named(spoilt: AgentCost, words: str) -> None:
    assert result(AGENT).problems() == []
    (sentence,) = result(AGENT, replace(spoilt, name="mav1")).problems()
    assert sentence.startswith("mav1")
    assert words in sentence


def test_a_vehicle_whose_order_fails_at_once_does_not_let_the_bench_order_on_and_on() -> None:
    given: list[str] = []

    class Mover:
        def __init__(self, name: str) -> None:
            self.name = name

        async def move(self, *_: object, **__: object) -> None:
            given.append(self.name)
            if self.name == "mav0":
                raise OrderFailed(Hold(vehicles=("mav0",)), {})
            await asyncio.sleep(0.05)

    config = fleet_from_mapping(fixture.fleet_data(2, 1.5))
    there = SimpleNamespace(
        config=config, fleet={name: Mover(name) for name in config.enabled_names}
    )

    async def for_a_while() -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.3):
                await bench_agents._move(cast(Any, there))

    asyncio.run(for_a_while())
    assert sorted(given) == ["mav0", "mav1"]


def test_loops_take_precedence_only_while_that_leaves_room_for_the_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    assert leaves_room(10)
    assert not leaves_room(11)
    assert "--realtime" not in agent_command("fleet.toml", "mav0", is_realtime=False)


def test_a_crowd_may_be_less_even() -> None:
    crowd = [replace(AGENT, name=f"mav{number}", p99_ms=28.0) for number in range(20)]
    assert result(*crowd).problems() == []
    assert len(result(*crowd[:10]).problems()) == 10


def test_a_staged_fleet_is_valid_whatever_its_size_and_knows_its_neighbours() -> None:
    for count in (1, 2, 3, 10, 20):
        fleet = fleet_from_mapping(fixture.fleet_data(count, 3.0))
        assert len(fleet.enabled_names) == count
        assert all(vehicle.direct for vehicle in fleet.vehicles.values())


def soak(**changes: object) -> Soak:
    found = Soak(
        minutes=1.0,
        time_s=[0.0, 5.0],
        memory_mib={"mav0": [30.0, 30.1]},
        growth_mib={"mav0": 0.1, "ground": 3.0},
        orders=10,
        missed=[],
        late=[],
    )
    return replace(found, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"growth_mib": {"mav0": 1.2}}, "mav0 grew by 1.20 MiB"),
        ({"growth_mib": {"mav0": float("nan")}}, "mav0 grew by nan"),
        ({"missed": ["mav1 timed out"]}, "mav1 timed out"),
        ({"late": [LateTick("mav2", 61.0, 33.0, "")]}, "unexplained"),
    ],
)
def test_a_soak_that_is_not_as_asked_says_why(changes: dict[str, object], words: str) -> None:
    assert soak().problems() == []
    assert soak(late=[LateTick("mav2", 61.0, 33.0, "all processors were busy")]).problems() == []
    (sentence,) = soak(**changes).problems()
    assert words in sentence


def test_growth_is_counted_from_the_end_of_the_settling_to_the_last_minute() -> None:
    samples = Samples()
    samples.time_s = [5.0 * number for number in range(121)]  # ten minutes
    # grows for five of them
    samples.memory_mib["mav0"] = [30.0 + min(number, 60) * 0.1 for number in range(121)]
    assert samples.growth_mib("mav0", 300.0) == pytest.approx(0.0)
    assert samples.growth_mib("mav0", 120.0) == pytest.approx(3.1, abs=0.3)
    assert samples.growth_mib("mav0", 700.0) != samples.growth_mib("mav0", 700.0)  # nan: too short


def test_a_late_tick_is_explained_by_others_or_a_busy_machine_and_by_nothing_else() -> None:
    watcher = Watcher()
    watcher.late = [
        ("mav0", 10.0, 40.0),
        ("mav1", 10.1, 45.0),
        ("mav0", 50.0, 25.0),
        ("mav2", 90.0, 25.0),
    ]
    watcher.busy = [(50.5, 0.99), (90.5, 0.4)]
    first, second, busy, alone = watcher.explained()
    assert "mav1" in first.explained
    assert "mav0" in second.explained
    assert "busy" in busy.explained
    assert alone.explained == ""


def test_the_soak_is_drawn(tmp_path: Path) -> None:
    draw(soak(late=[LateTick("mav2", 61.0, 33.0, "")]), tmp_path / "soak.png")
    assert (tmp_path / "soak.png").stat().st_size > 5000


def test_usage_counts_this_process_and_nobody() -> None:
    begin = usage(os.getpid())
    assert begin is not None
    kept = bytearray(os.urandom(1 << 20) * 20)
    while (now := usage(os.getpid())) is not None and now.cpu_s <= begin.cpu_s:
        sum(range(100_000))
    assert now is not None
    assert now.own_mib > begin.own_mib + 10.0
    assert now.rss_mib >= now.own_mib
    assert len(kept) == 20 << 20
    assert usage(2**22 + 1) is None


@pytest.mark.parametrize("main", [bench_agents.main, bench_soak.main])
def test_nonsense_is_refused_in_words(main: object, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--agents", "0"] if main is bench_agents.main else ["--minutes", "0"]
    assert main(words) == 2  # type: ignore[operator]
    assert "give" in capsys.readouterr().err
