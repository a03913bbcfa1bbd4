"""``covey px4 params`` against the emulated PX4: by the agent's link, past an agent, never in the
air.
"""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from groundstation.cli import main
from groundstation.client.autopilot_link import AutopilotLink, LinkSilentError
from groundstation.px4 import vehicle_info
from groundstation.px4.parameter_changes import Outcome, store, write_all
from groundstation.px4.parameter_sets import restore
from groundstation.px4.vehicle_links import VehicleLink
from groundstation.px4.vehicle_parameters import (
    ParameterState,
    VehicleParams,
    exit_status,
    read_one,
    set_all,
)
from onboard.config.fleet import FleetConfig, Vehicle, load_fleet
from onboard.px4.port_lock import PortClaim
from onboard.px4.required_params import (
    RequiredParam,
    all_params,
    differences,
    required_params,
    weakened,
)

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
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FleetConfig:
    monkeypatch.chdir(tmp_path)  # backups are written here
    path = tmp_path / "fleet.toml"
    agent = free_port(socket.SOCK_STREAM)
    path.write_text(
        FLEET.format(agent=agent, port=free_port(), direct=free_port()), encoding="utf-8"
    )
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
    assert (
        "WRONG   COM_OF_LOSS_T    1, should be 0.3: PX4 acts after so long without setpoints"
        in shown
    )
    assert "better  EKF2_EVP_NOISE   0.1, should be 0.01" in shown
    assert (
        "WRONG   MPC_Z_P          1, should be 0.8: the fleet file's px4_params require it" in shown
    )
    assert "WRONG   MPC_XY_P         0.95, should be 0.9" in shown

    assert main(["px4", "params", "--fleet", fleet.path, "--apply"]) == 0
    applied = capsys.readouterr().out
    assert "set     COM_OBL_RC_ACT   0 -> 4, read back" in applied
    assert "set     EKF2_DELAY_MAX   200 -> 110, read back" in applied  # PX4 allows no less
    assert "Stored: PX4 keeps them over a restart." in applied
    assert (
        "Restart PX4: it reads EKF2_HGT_REF, EKF2_MAG_TYPE, EKF2_DELAY_MAX only when it starts."
        in applied
    )

    assert main(["px4", "params", "--fleet", fleet.path, "--json"]) == 0
    said = told(capsys)["solo"]
    assert said["is_fine"]
    assert said["asked_at"] == fleet.vehicles["solo"].autopilot
    assert said["params"]["COM_OF_LOSS_T"]["is"] == pytest.approx(0.3)
    assert said["params"]["EKF2_EV_CTRL"]["is"] == 15


class SlowPx4:
    """PX4 that loses at a restart all that it has not stored."""

    def __init__(self, *results: int | None) -> None:
        self.results = list(results)
        self.sent = 0

    def __call__(self, wait_s: float) -> int | None:
        self.sent += 1
        return self.results.pop(0) if self.results else 0


def test_parameters_count_as_stored_only_once_px4_accepts_the_next_storing() -> None:
    busy = 1
    denied = 2
    for results, commands in (
        ((), 2),
        ((0, busy, busy, 0), 4),
        ((None, 0, None, 0), 4),
        ((busy, 0, 0), 3),
    ):
        px4 = SlowPx4(*results)
        assert store(px4, 5.0, lambda _: None), results
        assert px4.sent == commands, results

    assert not store(SlowPx4(*[0, *[busy] * 1_000_000]), 0.02, lambda _: None)
    assert not store(SlowPx4(*[denied] * 1_000_000), 0.02, lambda _: None)


def told(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    said: dict[str, Any] = json.loads(capsys.readouterr().out)
    return said


def test_parameters_that_px4_did_not_store_are_no_success(
    fleet: FleetConfig,
    emulator: subprocess.Popen[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with monkeypatch.context() as patch:
        # failed
        patch.setattr(
            "groundstation.client.autopilot_link.AutopilotLink.request_storage", lambda *_: 4
        )
        patch.setattr("groundstation.px4.parameter_changes._STORE_S", 0.3)
        assert main(["px4", "params", "--fleet", fleet.path, "--apply"]) == 1
    assert "did not confirm that it stored them" in capsys.readouterr().out


def test_past_an_agent_that_holds_the_link_px4s_ground_link_is_asked_and_again_by_the_next_process(
    fleet: FleetConfig, emulator: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    vehicle = fleet.vehicles["solo"]
    claim = PortClaim(vehicle.autopilot)
    claim.take()
    try:
        assert main(["px4", "params", "--fleet", fleet.path, "--apply", "--json"]) == 0
        first = told(capsys)["solo"]
        assert first["asked_at"] == vehicle.direct
        assert first["is_stored"]

        # PX4 answers only to the first address that spoke to it: another process has to be at the
        # same one
        command = [sys.executable, "-m", "groundstation", "px4", "params", "--fleet", fleet.path]
        again = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
        assert again.returncode == 0, again.stdout + again.stderr
        assert f"read at {vehicle.direct}: all" in again.stdout

        assert main(["px4", "info", "--fleet", fleet.path]) == 0
        assert "in use" in capsys.readouterr().out  # why the vehicle's own link was not asked
    finally:
        claim.release()


def test_an_armed_vehicle_is_read_but_never_set(
    fleet: FleetConfig,
    emulator: subprocess.Popen[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    vehicle = fleet.vehicles["solo"]
    assert (
        main(["px4", "params", "--fleet", fleet.path, "--dump", str(tmp_path / "all.params")]) == 0
    )

    assert vehicle.direct is not None
    link = AutopilotLink(vehicle.direct, vehicle.system_id)

    end_s = time.monotonic() + 12.0
    while not link.is_armed(2.0):
        assert time.monotonic() < end_s
        link.command(400, 1.0)
    link.stop()
    capsys.readouterr()

    assert main(["px4", "params", "--fleet", fleet.path, "--apply", "--json"]) == 1
    answer = told(capsys)["solo"]
    assert answer["answers"]
    assert "armed" in answer["trouble"]
    assert not any(row["was_set"] for row in answer["params"].values())

    assert (
        main(["px4", "params", "--fleet", fleet.path, "--restore", str(tmp_path / "all.params")])
        == 1
    )
    assert "nothing was changed. It is armed" in capsys.readouterr().out

    assert not list(Path.cwd().glob("px4-*.params"))  # nothing was changed, nothing is to be undone


class ArmedMeanwhile(AutopilotLink):
    """A link to a PX4 that was armed after the command had begun."""

    def __init__(self) -> None:
        self.endpoint = "udpin://127.0.0.1:14540"
        self.written: list[str] = []

    def is_armed(self, timeout_s: float = 1.0) -> bool:
        return True

    def read(self, name: str) -> float:
        return 0.0

    def read_all(self) -> dict[str, float | int]:
        return {"MPC_Z_P": 1.0}

    def write(self, name: str, value: float) -> float:
        self.written.append(name)
        return value


def test_a_vehicle_that_is_armed_meanwhile_is_not_set(fleet: FleetConfig, tmp_path: Path) -> None:
    px4 = ArmedMeanwhile()
    link = VehicleLink(fleet.vehicles["solo"], px4, is_armed=False)

    (state,) = set_all([link], [read_one(link, fleet)], tmp_path / "before.params")
    assert "It is armed" in state.trouble

    file = tmp_path / "other.params"
    file.write_text("3\t1\tMPC_Z_P\t0.8\t9\n", encoding="utf-8")
    (report,) = restore([link], file, tmp_path / "second.params")
    assert report.headline.startswith("nothing was changed. It is armed")
    assert px4.written == []


def test_without_an_answer_the_status_is_10_and_the_sentence_says_what_to_do(
    fleet: FleetConfig, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("groundstation.px4.vehicle_links._ANSWER_S", 0.3)
    assert main(["px4", "params", "--fleet", fleet.path]) == 10
    assert "Start PX4, or check cable and ports." in capsys.readouterr().out

    for words in (["params", "--dump", "none.params"], ["info"]):
        assert main(["px4", *words, "--fleet", fleet.path]) == 10
    assert not Path("none.params").exists()
    assert main(["px4", "params", "--fleet", fleet.path, "--vehicles", "nobody"]) == 2


def test_all_parameters_are_saved_compared_and_written_back(
    fleet: FleetConfig, emulator: subprocess.Popen[str], capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["px4", "params", "--fleet", fleet.path]
    assert main([*command, "--dump", "before.params"]) == 0
    assert "parameters of PX4 v1." in capsys.readouterr().out
    assert main([*command, "--dump", "before.params"]) == 2  # never overwritten

    assert main([*command, "--diff", "before.params"]) == 0
    assert main([*command, "--apply", "--backup", "backup.params"]) == 0
    assert "Write them back with --restore backup.params" in capsys.readouterr().out

    assert (
        Path("backup.params").read_text().splitlines()[3:]
        == Path("before.params").read_text().splitlines()[3:]
    )

    assert main([*command, "--diff", "before.params"]) == 1
    assert "COM_OF_LOSS_T    0.3, there 1" in capsys.readouterr().out

    assert main([*command, "--restore", "backup.params"]) == 0
    restored = capsys.readouterr().out
    assert "set           COM_OF_LOSS_T    0.3 -> 1, now 1" in restored
    assert "PX4 has stored them" in restored

    assert main([*command, "--diff", "before.params"]) == 0
    own = fleet.vehicles["solo"].system_id
    other = Path("before.params").read_text().replace(f"\n{own}\t", "\n77\t")
    Path("other.params").write_text(other)
    capsys.readouterr()

    assert main([*command, "--restore", "other.params"]) == 2  # another vehicle's
    assert "holds vehicles 77" in capsys.readouterr().err

    # a fleet may be compared with one good vehicle
    assert main([*command, "--diff", "other.params"]) == 0


def test_each_vehicle_is_asked_for_what_its_version_needs_and_says_what_it_is(
    fleet: FleetConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "two.toml"
    other = fleet.text[
        fleet.text.index("[vehicles.solo]") : fleet.text.index("[vehicles.solo.px4_params]")
    ]
    other = other.replace("solo", "other").replace("[0.0,", "[9.0,")
    other = other.replace("system_id = 3", 'system_id = 4\ntype = "new"')

    for port in re.findall(r":(\d+)\"", other):
        other = other.replace(port, str(free_port()))

    types = '[types.old]\nhover_thrust_frac = 0.5\npx4_version = "1.16"\n'
    types += '[types.new]\npx4_version = "1.18"\n'
    text = fleet.text.replace("[defaults]", f"{types}[defaults]").replace(
        'type = "sih"', 'type = "old"'
    )
    path.write_text(f"{text}{other}", encoding="utf-8")

    with subprocess.Popen(
        [sys.executable, "-m", "sitl", "--fleet", str(path), "--no-bus"],
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        try:
            assert main(["px4", "params", "--fleet", str(path), "--json"]) == 1
            params = {name: said["params"] for name, said in told(capsys).items()}
            assert main(["px4", "params", "--fleet", str(path)]) == 1
            assert "Not all are of one version (PX4 v1.16, PX4 v1.18)" in capsys.readouterr().out
            assert main(["px4", "info", "--fleet", str(path), "--json"]) == 0
            infos = told(capsys)
        finally:
            process.terminate()

    assert "COM_RC_OVERRIDE" in params["solo"].keys() - params["other"].keys()
    assert params["other"]["MAN_OVERRIDE_SPD"]["is"] is not None
    assert "MAN_OVERRIDE_SPD" not in params["solo"]
    assert infos["solo"]["version"].startswith("PX4 v1.16.")
    assert infos["other"]["version"].startswith("PX4 v1.18.")

    said = infos["solo"]
    vehicle = fleet.vehicles["solo"]
    assert said["uptime"].startswith("0 h 0 min")
    assert said["state"].startswith("disarmed, ")
    assert "gyroscope" in said["sensors"]
    assert f"{vehicle.autopilot}: " in said["links"]
    assert f"{vehicle.direct}: answers" in said["links"]
    assert set(said) >= {"board", "satellites"}


class _LossyLink:
    """A PX4 of which some answers are lost."""

    def __init__(self, lost: int) -> None:
        self.lost = lost
        self.asked = 0

    def listen(self, seconds: float, requested: object, **_: object) -> dict[str, str]:
        self.asked += 1
        return {} if self.asked <= self.lost else {"AUTOPILOT_VERSION": "v1.16"}


@pytest.mark.parametrize(("lost", "answers"), [(0, True), (1, True), (2, False)])
def test_px4_is_asked_three_times_for_its_version(lost: int, answers: bool) -> None:
    link = _LossyLink(lost)
    heard = vehicle_info._version_again(link, {})  # type: ignore[arg-type]
    assert ("AUTOPILOT_VERSION" in heard) is answers
    assert link.asked == min(lost + 1, 2)  # the first time is part of listening

    assert vehicle_info._version_again(link, {"AUTOPILOT_VERSION": "v1.16"}) == {}  # type: ignore[arg-type]


def test_a_link_that_dies_in_the_middle_leaves_a_list_of_what_was_set_and_a_backup(
    fleet: FleetConfig,
    emulator: subprocess.Popen[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write = AutopilotLink.write
    written = []

    def write_and_die(link: AutopilotLink, name: str, value: float) -> float | None:
        written.append(name)
        if len(written) == 3:
            emulator.kill()
        return write(link, name, value)

    monkeypatch.setattr(AutopilotLink, "write", write_and_die)
    assert (
        main(
            [
                "px4",
                "params",
                "--fleet",
                fleet.path,
                "--apply",
                "--backup",
                "backup.params",
                "--json",
            ]
        )
        == 1
    )

    said = told(capsys)["solo"]
    outcomes = {name: row["outcome"] for name, row in said["params"].items() if row["outcome"]}
    assert list(outcomes.values())[:3] == ["set", "set", "not confirmed"]
    assert set(list(outcomes.values())[3:]) == {"not set"}

    assert (
        f"Set and read back: {written[0]}, {written[1]}. Sent and not confirmed: {written[2]}. "
        "Not sent: " in (said["trouble"])
    )

    assert not said["is_stored"]
    assert "COM_OF_LOSS_T" in Path("backup.params").read_text()


class StubbornPx4:
    """PX4 that knows some parameters, takes some, and falls silent at one."""

    def __init__(self) -> None:
        self.values: dict[str, float | None] = {
            "A": 0.0,
            "READ_ONLY": 7.0,
            "GONE": None,
            "LAST": 0.0,
        }

    def write(self, name: str, value: float) -> float | None:
        if name == "SILENT":
            raise LinkSilentError("PX4 fell silent.")
        if self.values[name] is not None and name != "READ_ONLY":
            self.values[name] = value
        return self.values[name]

    def request_storage(self, timeout_s: float) -> int | None:
        return 0


def test_what_became_of_each_parameter_is_said_by_name() -> None:
    px4 = StubbornPx4()
    required = [RequiredParam(name, 1.0, "") for name in ("A", "READ_ONLY", "GONE", "LAST")]
    changes, trouble = write_all(px4, required, px4.values)
    assert [change.outcome for change in changes] == [
        Outcome.SET,
        Outcome.REFUSED,
        Outcome.UNKNOWN,
        Outcome.SET,
    ]

    assert trouble == (
        "PX4 did not take READ_ONLY: read-only, or out of its range. This PX4 does not know GONE."
    )

    changes, trouble = write_all(
        px4, [RequiredParam(name, 2.0, "") for name in ("A", "SILENT", "LAST")], px4.values
    )
    assert [change.outcome for change in changes] == [Outcome.SET, Outcome.LOST, Outcome.UNTOUCHED]
    assert "Set and read back: A. Sent and not confirmed: SILENT. Not sent: LAST." in trouble


def test_the_exit_status_tells_mixed_results() -> None:
    good = VehicleParams("a", "x", ())
    bad = VehicleParams("b", "x", (), "armed")
    assert exit_status([good]) == 10  # nothing was told at all

    paper = load_fleet("configs/fleets/paper.toml")
    rows = tuple(_row(demand) for demand in all_params(paper, paper.vehicles["mav0"]))
    good = VehicleParams("a", "x", rows)
    bad = VehicleParams("b", "x", rows, "armed")

    assert exit_status([good, good]) == 0
    assert exit_status([bad, bad]) == 1
    assert exit_status([good, bad]) == 50


def _row(demand: RequiredParam) -> ParameterState:
    return ParameterState(demand, demand.value)


def test_a_fleet_files_own_parameters_replace_the_built_in_ones(fleet: FleetConfig) -> None:
    vehicle = fleet.vehicles["solo"]
    required = required_params(fleet, vehicle)
    assert required["MPC_Z_P"].value == 0.8
    assert "EKF2_EVP_NOISE" not in required
    assert "EKF2_EVP_NOISE" in {demand.name for demand in all_params(fleet, vehicle)}
    silence = [required["COM_OF_LOSS_T"]]
    assert differences(silence, {"COM_OF_LOSS_T": 0.30000001}) == ()
    assert "did not send" in differences(silence, {})[0]


def _by_vision(fleet: FleetConfig, **px4_params: int) -> Vehicle:
    return replace(
        fleet.vehicles["solo"], mocap_required=False, px4_position="vision", px4_params=px4_params
    )


def test_a_vehicle_by_vision_is_advised_to_believe_its_odometry(fleet: FleetConfig) -> None:
    params = all_params(fleet, _by_vision(fleet))
    advice = {param.name: param for param in params if param.is_advice}
    assert advice["EKF2_EVP_NOISE"].is_met(0.02)
    assert not advice["EKF2_EVP_NOISE"].is_met(0.1)
    assert {"EKF2_HGT_REF", "EKF2_MAG_TYPE"} <= set(advice)

    by_satellites = replace(fleet.vehicles["solo"], mocap_required=False)
    assert not [one for one in all_params(fleet, by_satellites) if one.name.startswith("EKF2_")]


def test_a_vehicle_by_vision_takes_off_only_if_its_px4_flies_by_the_odometry(
    fleet: FleetConfig,
) -> None:
    required = required_params(fleet, _by_vision(fleet))
    fused = required["EKF2_EV_CTRL"]
    assert [value for value in range(16) if fused.is_met(value)] == [0b1011, 0b1111]
    satellites = required["EKF2_GPS_CTRL"]
    assert [value for value in range(16) if satellites.is_met(value)] == list(range(0, 16, 2))


def test_a_camera_that_knows_no_heading_leaves_px4_its_compass(fleet: FleetConfig) -> None:
    vehicle = _by_vision(fleet, EKF2_EV_CTRL=0b0011)
    params = {param.name: param for param in all_params(fleet, vehicle)}
    assert params["EKF2_EV_CTRL"].is_met(0b0011)
    assert not params["EKF2_EV_CTRL"].is_met(0b1011)
    assert "EKF2_MAG_TYPE" not in params
    assert weakened(fleet, vehicle) == ()


@pytest.mark.parametrize(
    ("name", "value"), [("EKF2_EV_CTRL", 0), ("EKF2_EV_CTRL", 9), ("EKF2_GPS_CTRL", 7)]
)
def test_px4_params_do_not_take_the_odometry_from_a_vehicle_by_vision(
    fleet: FleetConfig, name: str, value: int
) -> None:
    vehicle = _by_vision(fleet, **{name: value})
    (sentence,) = weakened(fleet, vehicle)
    assert f"px4_params set {name} = {value}" in sentence
    assert not required_params(fleet, vehicle)[name].is_met(value)


def test_a_stick_that_is_bumped_takes_no_vehicle_out_of_offboard_on_any_version() -> None:
    paper = load_fleet("paper")
    vehicle = paper.vehicles["mav0"]
    old = required_params(paper, vehicle, (1, 16))
    new = required_params(paper, vehicle, (1, 18))
    assert old == required_params(paper, vehicle, (1, 17))
    assert new == required_params(paper, vehicle, (1, 19))
    # of a version that is not known
    assert not {"COM_RC_OVERRIDE", "MAN_OVERRIDE_SPD"} & set(required_params(paper, vehicle))
    assert "MAN_OVERRIDE_SPD" not in old
    assert "COM_RC_OVERRIDE" not in new

    before = {name: demand.value for name, demand in old.items()}
    now = {name: demand.value for name, demand in new.items()}
    assert (before["COM_RC_OVERRIDE"], now["MAN_OVERRIDE_SPD"]) == (0, -1.0)
    assert differences(old.values(), {**before, "COM_RC_OVERRIDE": 1}) == ()
    wrong = differences(old.values(), {**before, "COM_RC_OVERRIDE": 3})
    assert "COM_RC_OVERRIDE is 3" in wrong[0]
    assert "MAN_OVERRIDE_SPD is 1" in differences(new.values(), {**now, "MAN_OVERRIDE_SPD": 1.0})[0]
