"""Two real agents for one vehicle, as on two hosts: not connected to each other, told by a third,
neither flies.
"""

from __future__ import annotations

import copy
import socket
from pathlib import Path

import pytest

from groundstation.processes.free_ports import toml_text
from tests.bench.fixture import BenchFleet, fleet_data

pytestmark = [pytest.mark.long, pytest.mark.timeout(180)]


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def test_a_second_agent_elsewhere_grounds_the_first_until_it_is_gone(tmp_path: Path) -> None:
    data = fleet_data(2, 2.0, "doubled")
    elsewhere = copy.deepcopy(data)
    elsewhere["vehicles"]["mav0"]["agent"] = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    elsewhere["vehicles"]["mav0"]["autopilot"] = f"udpin://127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    path = tmp_path / "elsewhere.toml"
    path.write_text(toml_text(elsewhere), encoding="utf-8")
    async with BenchFleet(data, tmp_path) as bench_fleet:
        client = bench_fleet.client

        def is_warned() -> bool:
            telemetry = client.state.vehicles["mav0"].telemetry
            return telemetry is not None and any(
                "nother agent" in reason for reason in telemetry.not_ready
            )

        assert not is_warned()
        bench_fleet.processes.start("twin", ["onboard", "--fleet", str(path), "--vehicle", "mav0"])
        assert await client.wait_for(lambda _: is_warned(), 60.0)
        (result,) = (await client.order("takeoff mav0 1", 20.0)).values()
        assert result.phase == "refused"
        assert "nother agent" in result.sentence

        twin = next(one for one in bench_fleet.processes._started if one.name == "twin")
        twin.process.terminate()
        assert await client.wait_for(lambda _: not is_warned(), 60.0)
