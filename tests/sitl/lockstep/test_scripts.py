"""Python scripts in lockstep: with asyncio, blocking, and Crazyswarm's; the same files fly in real
time.
"""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from groundstation import Fleet
from groundstation.cli import main
from groundstation.crazyswarm.uav_trajectory import Trajectory
from groundstation.missions.api import NotReady
from groundstation.missions.connection import host_of
from onboard.config.fleet import ConfigError
from sitl.faults.catalogue import Fault

PAPER = Path(__file__).resolve().parents[3] / "configs/fleets/paper.toml"

ASYNC = """
import asyncio
import sys

from groundstation import Fleet


async def main() -> None:
    async with Fleet.connect("paper", at_end="land") as fleet:
        await fleet.takeoff(1.0)
        if "--fail" in sys.argv:
            raise ValueError("as asked")
        await fleet.home()


asyncio.run(main())
"""

BLOCKING = """
from groundstation import BlockingFleet

with BlockingFleet("paper") as fleet:
    fleet.takeoff(1.0, "mav0")
    x, y, z = fleet["mav0"].position_enu_m
    fleet["mav0"].go_to((x, y + 0.4, z))
    assert abs(fleet["mav0"].position_enu_m[1] - y - 0.4) < 0.2
"""

CRAZYSWARM = """
import numpy as np

from groundstation.crazyswarm import Crazyswarm, uav_trajectory

swarm = Crazyswarm()
clock, everybody = swarm.timeHelper, swarm.allcfs
wave = uav_trajectory.Trajectory()
wave.loadcsv("wave.csv")
begin = clock.time()
everybody.takeoff(targetHeight=1.0, duration=2.0)
clock.sleep(2.5)
assert abs(clock.time() - begin - 2.5) < 0.03, clock.time() - begin
assert not clock.isShutdown()
left, middle, right = everybody.crazyflies
assert everybody.crazyfliesById[middle.id] is middle
for own, other in ((left, right), (right, left)):
    own.goTo(other.initialPosition + np.array([0, 0, 1.0]), 0, 4.0)
clock.sleep(4.0)
assert np.linalg.norm(left.position() - right.initialPosition - [0, 0, 1.0]) < 0.25, left.position()
left.setLEDColor(1.0, 0.5, 0.0)
middle.setGroupMask(2)
middle.uploadTrajectory(7, 0, wave)
everybody.startTrajectory(7, timescale=1.2, groupMask=2)
clock.sleep(1.2 * wave.duration + 0.1)
everybody.startTrajectory(7, timescale=1.2, reverse=True, groupMask=2)
clock.sleep(1.2 * wave.duration + 0.1)
off_m = np.linalg.norm(middle.position() - middle.initialPosition - [0, 0, 1.0])
assert off_m < 0.25, middle.position()
everybody.land(targetHeight=0.04, duration=2.0)
clock.sleep(2.5)
everybody.stop()
clock.sleep(0.5)
"""

# duration, then eight coefficients of x, y, z and yaw; from rest to rest over 0.6 m of y; a comma
# ends the first line
WAVE = (
    "duration,"
    + ",".join(f"{axis}^{k}" for axis in ("x", "y", "z", "yaw") for k in range(8))
    + ",\n"
    "2.0," + "0," * 11 + f"{0.6 * 10 / 8},{-0.6 * 15 / 16},{0.6 * 6 / 32}," + "0," * 17 + "0\n"
)


def _script(folder: Path, text: str) -> str:
    path = folder / "script.py"
    path.write_text(text, encoding="utf-8")
    (folder / "wave.csv").write_text(WAVE, encoding="utf-8")
    return str(path)


@pytest.mark.long
def test_a_script_with_asyncio_flies_and_has_a_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script = _script(tmp_path, ASYNC)
    flown = ["run", script, "--fleet", str(PAPER), "--lockstep", "--record"]
    assert main([*flown, str(tmp_path / "one")]) == 0
    assert "PASSED" in capsys.readouterr().out
    assert (tmp_path / "one/verdict.json").exists()
    assert main([*flown, str(tmp_path / "two"), "--", "--fail"]) == 1
    out = capsys.readouterr().out
    assert "ValueError: as asked" in out
    assert "Landed and disarmed: mav0, mav1, mav2." in out


@pytest.mark.long
def test_a_blocking_script_is_landed_at_its_end(lockstep: Any, tmp_path: Path) -> None:
    flight = lockstep(PAPER, seed=3)
    flight.run_script(_script(tmp_path, BLOCKING))
    assert flight.state.vehicles["mav0"].truth.is_on_ground
    assert not flight.state.vehicles["mav0"].is_armed
    assert flight.flown is not None


def test_a_test_connects_with_its_own_flight(lockstep: Any) -> None:
    flight = lockstep(PAPER, seed=3)

    async def hops() -> float:
        async with Fleet.connect("paper", at_end="hold") as fleet:
            await fleet["mav1"].takeoff(0.8)
            position_enu_m = fleet["mav1"].position_enu_m
            assert position_enu_m is not None
            return position_enu_m[2]

    assert flight.wait_for(hops()) == pytest.approx(0.8, abs=0.15)
    assert flight.state.vehicles["mav1"].is_airborne

    # a second script, which is never ready, brings down nothing that others have ordered
    flight.inject(Fault("mocap_lost", "mav0", at_s=flight.time_s))
    flight.run(3.0)

    async def is_refused() -> None:
        async with Fleet.connect("paper", at_end="land", ready_timeout_s=20.0):
            raise AssertionError("mav0 is not ready")

    with pytest.raises(NotReady, match="mav0"):
        flight.wait_for(is_refused())
    flight.run(3.0)
    assert flight.state.vehicles["mav1"].is_airborne
    assert flight.flown is not None
    assert flight.flown.is_left_flying
    with pytest.raises(ConfigError, match="Which fleet"):
        host_of(None)


TWICE = {
    "one after the other": """
        async def main():
            for _ in range(2):
                async with Fleet.connect(ready_timeout_s=0.0):
                    print("connected")

        asyncio.run(main())
    """,
    "at once": """
        first = BlockingFleet(ready_timeout_s=0.0)
        print("connected")
        second = BlockingFleet(ready_timeout_s=0.0)
    """,
}


@pytest.mark.parametrize("body", TWICE.values(), ids=TWICE)
def test_a_script_connects_once_because_its_record_and_its_verdict_are_of_one_connection(
    lockstep: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], body: str
) -> None:
    head = "import asyncio\nfrom groundstation import BlockingFleet, Fleet\n"
    script = _script(tmp_path, head + textwrap.dedent(body))
    flight = lockstep(PAPER, seed=3)
    for _ in range(2):  # a second script of the same flight has a connection of its own
        with pytest.raises(ConfigError, match="The script has connected with its fleet before"):
            flight.run_script(script)
        assert capsys.readouterr().out == "connected\n"


REFUSED_CALLS = {
    "another thread": (
        """
        said = []

        def order():
            try:
                fleet.takeoff(1.0)
            except Exception as error:
                said.append(error)

        with BlockingFleet(ready_timeout_s=0.0) as fleet:
            thread = threading.Thread(target=order)
            thread.start()
            thread.join()
        raise said[0]
        """,
        "for the script's first thread only",
    ),
    "a function for run": (
        """
        async def hop(_):
            fleet.takeoff(1.0)

        with BlockingFleet(ready_timeout_s=0.0) as fleet:
            fleet.run(hop)
        """,
        "use the fleet that it gets, with await",
    ),
    "asyncio": (
        """
        async def main():
            BlockingFleet(ready_timeout_s=0.0)

        asyncio.run(main())
        """,
        "in asyncio.run use Fleet.connect",
    ),
}


@pytest.mark.parametrize(("body", "words"), REFUSED_CALLS.values(), ids=REFUSED_CALLS)
def test_a_blocking_verb_is_refused_where_no_simulated_time_could_pass(
    lockstep: Any, tmp_path: Path, body: str, words: str
) -> None:
    head = "import asyncio\nimport threading\nfrom groundstation import BlockingFleet\n"
    flight = lockstep(PAPER, seed=3)
    with pytest.raises(ConfigError, match=words):
        flight.run_script(_script(tmp_path, head + textwrap.dedent(body)))
    flight.run(0.5)
    assert all(view.telemetry.taken_order_id == "" for view in flight.state.vehicles.values())


@pytest.mark.long
def test_a_script_of_crazyswarm_flies_with_its_import_line_changed(
    lockstep: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = _script(tmp_path, CRAZYSWARM)
    monkeypatch.chdir(tmp_path)
    flight = lockstep(PAPER, seed=3)
    flight.run_script(script)
    assert flight.min_separation_m > 0.8
    for name in flight.config.enabled_names:
        assert flight.state.vehicles[name].truth.is_on_ground
    assert flight.state.vehicles["mav0"].light == (255, 128, 0)


REFUSED = """
one = everybody.crazyflies[0]
one.takeoff(1.0, 2.0)
clock.sleep(2.0)
said = []


def tried(function, *arguments, passes_s=0.0):
    try:
        function(*arguments)
        clock.sleep(passes_s)
    except Exception as error:
        said.append(str(error))


one.uploadTrajectory(1, 0, wave)
tried(one.cmdVelocityWorld, [0.1, 0, 0], 0)
tried(one.goTo, [9.0, 0, 1.0], 0, 2.0, passes_s=100.0)
tried(one.startTrajectory, 3)
tried(one.stop)
tried(one.getParam, "ring/effect")
tried(one.startTrajectory, 1, 0.3, passes_s=100.0)
open("said.txt", "w").write("\\n".join(said))
raise SystemExit(3)
"""


@pytest.mark.long
def test_a_script_of_crazyswarm_is_refused_in_words(
    lockstep: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flight = lockstep(PAPER, seed=3)
    with pytest.raises(SystemExit):
        flight.run_script(_script(tmp_path, CRAZYSWARM.partition("everybody.takeoff")[0] + REFUSED))
    said = (tmp_path / "said.txt").read_text().splitlines()
    words = (
        "setpoints that are streamed",
        "outside the geofence",
        "no trajectory 3",
        "would fall",
        "covey px4 params",
        "timescale",
    )
    assert len(said) == len(words), said
    for sentence, expected in zip(said, words, strict=True):
        assert expected in sentence
    assert flight.time_s < 60.0  # a refusal ends the sleep
    assert flight.state.vehicles["mav0"].truth.is_on_ground


def test_a_trajectory_of_crazyswarm_is_evaluated(tmp_path: Path) -> None:
    _script(tmp_path, "")
    wave = Trajectory()
    wave.loadcsv(tmp_path / "wave.csv")
    assert wave.duration == pytest.approx(2.0)
    assert wave.n_pieces() == 1
    assert wave.eval(2.0).pos == pytest.approx([0.0, 0.6, 0.0], abs=1e-5)
    assert math.isclose(wave.eval(1.0).vel[1], 0.6 * 15 / 16, rel_tol=1e-4)


def test_a_trajectory_of_crazyswarm_has_the_body_rates_of_its_motion(tmp_path: Path) -> None:
    _script(tmp_path, "")
    wave = Trajectory()
    wave.loadcsv(tmp_path / "wave.csv")
    before = wave.eval(0.499)
    after = wave.eval(0.501)

    def up(acceleration: Any) -> Any:
        thrust = acceleration + np.array([0.0, 0.0, 9.80665])
        return thrust / np.linalg.norm(thrust)

    # along y only, heading east: it rolls, as the direction of its thrust turns
    turned = np.cross(up(before.acc), up(after.acc)) / 0.002
    assert wave.eval(0.5).omega == pytest.approx(turned, abs=1e-3)
    assert abs(wave.eval(0.5).omega[0]) > 0.05


ARMED = """
from groundstation.crazyswarm import Crazyswarm

swarm = Crazyswarm()
clock, everybody = swarm.timeHelper, swarm.allcfs
clock.visualizer.setGraph([(0, 1)])
for one in everybody.crazyflies:
    one.arm(True)
    clock.sleep(0.5)
clock.sleep(1.0)
armed = [one._orders.fleet[one.name].view.is_armed for one in everybody.crazyflies]
everybody.arm(False)
clock.sleep(1.0)
armed += [one._orders.fleet[one.name].view.is_armed for one in everybody.crazyflies]
open("armed.txt", "w").write(str(armed))
try:
    everybody.crazyfliesById[15]
except Exception as error:
    open("said.txt", "w").write(str(error))
"""


@pytest.mark.long
def test_a_script_of_crazyswarm_arms_and_disarms_on_the_ground(
    lockstep: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flight = lockstep(PAPER, seed=3)
    flight.run_script(_script(tmp_path, ARMED))
    assert (tmp_path / "armed.txt").read_text() == str([True] * 3 + [False] * 3)
    said = (tmp_path / "said.txt").read_text()
    assert said.startswith("The fleet has no vehicle with id 15; it has 1, 2, 3.")


def test_a_mission_and_a_script_are_told_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission = _script(
        tmp_path, 'FLEET = "paper"\n\n\nasync def mission(fleet):\n    await fleet.takeoff()\n'
    )
    assert main(["run", mission, "--fleet", "paper", "--lockstep"]) == 2
    assert "covey fly" in capsys.readouterr().err
    script = _script(tmp_path, BLOCKING)
    assert main(["fly", script, "--lockstep"]) == 2
    assert "covey fly script" in capsys.readouterr().err
