"""``covey px4 params`` against the emulated PX4: by the agent's link, past an agent, never in the air."""

from __future__ import annotations

import json
import math
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from groundstation.cli import main
from groundstation.client.direct_mavlink import DirectParams
from groundstation.commands.px4.vehicle_parameters import (
    ParameterState,
    VehicleParams,
    as_text,
    exit_status,
    in_own_process,
    read_or_set,
    store,
)
from onboard.config.fleet import FleetConfig, load_fleet
from onboard.px4.port_lock import PortClaim
from onboard.px4.required_params import all_params, differences, required_params

FLEET = """
schema = 1
[fleet]
name = "params-test"
geofence_m = {{ x = [-50.0, 50.0], y = [-50.0, 50.0], z = [0.0, 20.0] }}
[types.sih]
hover_thrust_frac = 0.49
[types.sih.px4_params]
MPC_XY_P = 0.9
[defaults]
type = "sih"
[vehicles.solo]
system_id = 3
start_enu_m = [0.0, 0.0, 0.0]
agent = "tcp/127.0.0.1:{agent}"
autopilot = "udpin://127.0.0.1:{port}"
direct = "udpout://127.0.0.1:{direct}"
[vehicles.solo.px4_params]
MPC_Z_P = 0.8
"""


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def fleet(tmp_path: Path) -> FleetConfig:
    path = tmp_path / "fleet.toml"
    agent = free_port(socket.SOCK_STREAM)
    path.write_text(FLEET.format(agent=agent, port=free_port(), direct=free_port()), encoding="utf-8")
    return load_fleet(path)


@pytest.fixture
def emulator(fleet: FleetConfig) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "sitl", "--fleet", fleet.path, "--no-bus"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        yield process
        process.terminate()
        process.wait(5)


def test_all_that_differs_is_shown_and_with_apply_set_and_read_back(
    fleet: FleetConfig, emulator: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["px4", "params", "--fleet", fleet.path]) == 1
    shown = capsys.readouterr().out
    assert "WRONG   COM_OF_LOSS_T    1, should be 0.3: PX4 acts after so long without setpoints" in shown
    assert "better  EKF2_EVP_NOISE   0.1, should be 0.01" in shown
    assert "WRONG   MPC_Z_P          1, should be 0.8: the fleet file's px4_params require it" in shown
    assert "WRONG   MPC_XY_P         0.95, should be 0.9" in shown
    assert main(["px4", "params", "--fleet", fleet.path, "--apply"]) == 0
    applied = capsys.readouterr().out
    assert "set     COM_OBL_RC_ACT   0 -> 4, read back" in applied
    assert "set     EKF2_DELAY_MAX   200 -> 110, read back" in applied  # PX4 allows no less
    assert "Stored: PX4 keeps them over a restart." in applied
    assert "Restart PX4: it reads EKF2_HGT_REF, EKF2_MAG_TYPE, EKF2_DELAY_MAX only when it starts." in applied
    assert main(["px4", "params", "--fleet", fleet.path, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["solo"]
    assert told["is_fine"]
    assert told["asked_at"] == fleet.vehicles["solo"].autopilot
    assert told["params"]["COM_OF_LOSS_T"]["is"] == pytest.approx(0.3)
    assert told["params"]["EKF2_EV_CTRL"]["is"] == 15


class SlowPx4:
    """PX4 that loses at a restart all that it has not stored."""

    def __init__(self, *results: int | None) -> None:
        self.results, self.sent = list(results), 0

    def __call__(self, wait_s: float) -> int | None:
        self.sent += 1
        return self.results.pop(0) if self.results else 0


def test_parameters_count_as_stored_only_once_px4_accepts_the_next_storing() -> None:
    busy, denied = 1, 2
    for results, commands in (((), 2), ((0, busy, busy, 0), 4), ((None, 0, None, 0), 4), ((busy, 0, 0), 3)):
        px4 = SlowPx4(*results)
        assert store(px4, 5.0, lambda _: None), results
        assert px4.sent == commands, results
    assert not store(SlowPx4(*[0, *[busy] * 1_000_000]), 0.02, lambda _: None)
    assert not store(SlowPx4(*[denied] * 1_000_000), 0.02, lambda _: None)


def test_parameters_that_px4_did_not_store_are_no_success(
    fleet: FleetConfig, emulator: subprocess.Popen[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("onboard.px4.mavsdk_link.Px4Link.request_storage", lambda *_: 4)  # failed
        patch.setattr("groundstation.commands.px4.vehicle_parameters._STORE_S", 0.3)
        answer = read_or_set(fleet.vehicles["solo"], applies=True)
    assert not answer.is_fine
    assert "did not confirm that it stored them" in as_text([answer])
    again = read_or_set(fleet.vehicles["solo"], applies=True)
    assert again.is_fine
    assert again.is_stored


def test_past_an_agent_that_holds_the_link_px4s_ground_link_is_asked_and_again_by_the_next_process(
    fleet: FleetConfig, emulator: subprocess.Popen[str]
) -> None:
    vehicle = fleet.vehicles["solo"]
    claim = PortClaim(vehicle.autopilot)
    claim.take()
    try:
        first = read_or_set(vehicle, applies=True)
        assert first.endpoint == vehicle.direct
        assert first.is_fine, first
        assert first.is_stored
        # PX4 answers only to the first address that spoke to it: another process has to be at the same one
        command = [sys.executable, "-m", "groundstation", "px4", "params", "--fleet", fleet.path]
        again = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
        assert again.returncode == 0, again.stdout + again.stderr
        assert f"read at {vehicle.direct}: all" in again.stdout
    finally:
        claim.release()


def test_an_armed_vehicle_is_read_but_never_set(fleet: FleetConfig, emulator: subprocess.Popen[str]) -> None:
    vehicle = fleet.vehicles["solo"]
    assert vehicle.direct is not None
    way = DirectParams(vehicle.direct, vehicle.system_id)
    end_s = time.monotonic() + 12.0
    while not way.is_armed(2.0):
        assert time.monotonic() < end_s
        way._link.mav.command_long_send(vehicle.system_id, 1, 400, 0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    way.stop()
    answer = read_or_set(vehicle, applies=True)
    assert answer.answers
    assert not answer.is_fine
    assert "armed" in answer.trouble
    assert not any(row.was_set for row in answer.rows)


def test_without_an_answer_the_status_is_10_and_the_sentence_says_what_to_do(
    fleet: FleetConfig, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.commands.px4.vehicle_parameters._ANSWER_S", 0.3)
    assert main(["px4", "params", "--fleet", fleet.path]) == 10
    assert "Start PX4, or check cable and ports." in capsys.readouterr().out
    assert main(["px4", "params", "--fleet", fleet.path, "--vehicles", "nobody"]) == 2


def test_the_exit_status_tells_mixed_results() -> None:
    good, bad = VehicleParams("a", "x", ()), VehicleParams("b", "x", (), "armed")
    assert exit_status([good]) == 10  # nothing was told at all
    vehicle = load_fleet("configs/fleets/paper.toml").vehicles["mav0"]
    rows = tuple(_row(demand) for demand in all_params(vehicle))
    good, bad = VehicleParams("a", "x", rows), VehicleParams("b", "x", rows, "armed")
    assert exit_status([good, good]) == 0
    assert exit_status([bad, bad]) == 1
    assert exit_status([good, bad]) == 50


def _row(demand: object) -> object:
    from onboard.px4.required_params import RequiredParam

    assert isinstance(demand, RequiredParam)
    return ParameterState(demand, demand.value)


def test_a_fleet_files_own_parameters_replace_the_built_in_ones(fleet: FleetConfig) -> None:
    vehicle = fleet.vehicles["solo"]
    assert required_params(vehicle)["MPC_Z_P"] == 0.8
    assert "EKF2_EVP_NOISE" not in required_params(vehicle)
    assert "EKF2_EVP_NOISE" in {demand.name for demand in all_params(vehicle)}
    assert differences({"COM_OF_LOSS_T": 0.3}, {"COM_OF_LOSS_T": 0.30000001}) == ()
    assert "did not send" in differences({"COM_OF_LOSS_T": 0.3}, {})[0]


def test_a_stick_that_is_bumped_takes_no_vehicle_out_of_offboard_on_any_version() -> None:
    vehicle = load_fleet("configs/fleets/paper.toml").vehicles["mav0"]
    old, new = required_params(vehicle, (1, 16)), required_params(vehicle, (1, 18))
    assert old == required_params(vehicle, (1, 17))
    assert new == required_params(vehicle, (1, 19))
    assert (old["COM_RC_OVERRIDE"], new["MAN_OVERRIDE_SPD"]) == (0, -1.0)
    assert not {"COM_RC_OVERRIDE", "MAN_OVERRIDE_SPD"} & set(required_params(vehicle))  # of a version that is not known
    assert "MAN_OVERRIDE_SPD" not in old
    assert "COM_RC_OVERRIDE" not in new
    assert differences(old, {**old, "COM_RC_OVERRIDE": 1}) == ()
    assert "COM_RC_OVERRIDE is 3" in differences(old, {**old, "COM_RC_OVERRIDE": 3})[0]
    assert "MAN_OVERRIDE_SPD is 1" in differences(new, {**new, "MAN_OVERRIDE_SPD": 1.0})[0]


def test_a_reading_that_crashes_ends_no_other_and_is_tried_twice() -> None:
    assert in_own_process(os.abort) is None
    assert in_own_process(math.hypot, 3.0, 4.0) == 5.0
