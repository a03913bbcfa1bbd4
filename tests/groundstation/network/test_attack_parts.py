"""The copy of a fleet that is attacked, the packets of the attackers, and what is refused before
anything starts.
"""

from __future__ import annotations

import contextlib
import threading
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import common

from groundstation.cli import main
from groundstation.network import stopped_reader
from groundstation.network.attack import attack_copies
from groundstation.network.attempts import NoProofError, attempts
from groundstation.network.fleet_copy import SPARE, copy_of
from groundstation.network.mavlink_frames import (
    HEARTBEAT,
    SETUP_SIGNING,
    disarmed,
    packet,
    signing_key,
)
from groundstation.network.order_attempts import kept_back
from groundstation.processes.free_ports import is_local, toml_text, with_free_ports
from onboard.bus.control_token import ControlToken
from onboard.bus.schema import Order
from onboard.config.fleet import ConfigError, load_fleet
from tests.groundstation.console.fake import telemetry

PAPER = Path(__file__).parents[3] / "configs" / "fleets" / "paper.toml"


def test_a_fleet_file_that_is_not_there_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["attack", "nowhere.toml"]) == 2
    assert "nowhere.toml" in capsys.readouterr().err


def test_an_order_that_was_kept_back_is_late_and_of_the_operator_if_there_is_one() -> None:
    hold = Order(
        order_id="intruder-1",
        author="intruder",
        node="ground-0-intruder",
        kind="hold",
        stamp_ns=0,
        deadline_ns=0,
        heard_ns=20_000_000_000,
    )
    late = kept_back(hold, telemetry("mav0", stamp_ns=20_000_000_000))
    assert (late.kind, late.node, late.heard_ns) == ("locate", hold.node, 10_000_000_000)

    operator = str(ControlToken("operator", 1, "ground-0-person", "person"))
    late = kept_back(hold, telemetry("mav0", stamp_ns=20_000_000_000, operator=operator))
    assert (late.node, late.heard_ns) == ("ground-0-person", 10_000_000_000)


def test_a_fleet_of_one_vehicle_has_nobody_whose_key_could_be_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = PAPER.read_text(encoding="utf-8")
    for name in ("mav1", "mav2"):
        text = text.replace(f"[vehicles.{name}]", f"[vehicles.{name}]\nenabled = false")
    (tmp_path / "one.toml").write_text(text, encoding="utf-8")
    assert main(["attack", str(tmp_path / "one.toml")]) == 2
    assert "needs two vehicles" in capsys.readouterr().err


def test_an_attempt_with_the_key_of_a_vehicle_that_is_not_copied_is_refused() -> None:
    last = load_fleet("twelve").enabled_names[-1]
    with pytest.raises(ConfigError, match="No try has"):
        attack_copies(load_fleet("twelve"), is_long=False, only=f"{last}'s key", say=print)


def test_a_reader_that_hears_nothing_ends(tmp_path: Path) -> None:
    paper = load_fleet("paper")
    file = tmp_path / "fleet.toml"
    file.write_text(toml_text(with_free_ports(tomllib.loads(paper.text), paper)), encoding="utf-8")

    reader = threading.Thread(target=stopped_reader.main, args=(str(file), 0.1), daemon=True)
    reader.start()
    reader.join(10.0)
    assert not reader.is_alive()


def test_fleets_are_copied_with_a_vehicle_more_and_without_what_is_not_here(tmp_path: Path) -> None:
    for number, name in enumerate(("paper", "mixed", "twelve", "px4-sitl")):
        original = load_fleet(name)
        copy = copy_of(original, tmp_path / str(number), is_locked=name == "paper")
        assert copy.enabled_names == original.enabled_names[:6]
        assert SPARE in copy.vehicles
        assert copy.has_keys is (name == "paper")
        assert not copy.emulated_names or copy.emulated_names == original.emulated_names
        assert all("127.0.0.1" in vehicle.agent for vehicle in copy.vehicles.values())


@pytest.mark.parametrize(
    "endpoint", ["quic/127.0.0.1:74{}", "tls/192.168.1.1{}:7447", "udp/127.0.0.1:74{}"]
)
def test_a_fleet_of_any_endpoints_is_copied(endpoint: str, tmp_path: Path) -> None:
    text = PAPER.read_text(encoding="utf-8")
    for number in range(3):
        text = text.replace(f"tcp/127.0.0.1:{7460 + number}", endpoint.format(60 + number))
    if "192.168" in endpoint:
        text = text.replace(
            "[fleet]", '[fleet]\nrouters = ["tls/192.168.1.2:7447", "tls/192.168.1.3:7447"]'
        )
    path = tmp_path / "fleet.toml"
    path.write_text(text, encoding="utf-8")
    original = load_fleet(path)
    assert original.vehicles["mav1"].agent == endpoint.format(61)
    for is_locked in (False, True):
        copy = copy_of(original, tmp_path / f"copy{is_locked}", is_locked=is_locked)
        assert is_local(copy)
        assert copy.has_keys is is_locked


@pytest.mark.parametrize("position", ["gps", "bus", "optitrack"])
def test_a_fleet_of_real_companions_is_copied(position: str, tmp_path: Path) -> None:
    options = ["--vehicles", "3", "--position", position, "--companions", "192.168.7.11"]
    assert main(["init", str(tmp_path / "lab"), *options]) == 0
    assert main(["secure", str(tmp_path / "lab" / "fleet.toml")]) == 0
    original = load_fleet(tmp_path / "lab" / "fleet.toml")
    copy = copy_of(original, tmp_path / "copy", is_locked=True)
    assert is_local(copy)
    # the ground link of each PX4 is attacked, although this fleet file names none
    assert not any(vehicle.direct for vehicle in original.vehicles.values())
    assert all(copy.vehicles[name].direct for name in copy.enabled_names)
    assert copy.vehicles[SPARE].direct is None


@pytest.mark.parametrize("name", ["SETUP_SIGNING in flight", "forged states of itself"])
def test_an_attempt_that_was_not_made_is_no_proof(name: str) -> None:
    paper = load_fleet("paper")
    first = replace(paper.vehicles["mav0"], direct=None)
    fleet = replace(paper, vehicles={**paper.vehicles, "mav0": first})
    deaf_node = SimpleNamespace(subscribe=lambda *_arguments: None)
    context: Any = SimpleNamespace(
        flight=SimpleNamespace(fleet=fleet, names=fleet.enabled_names, separation_m=2.0),
        joined=lambda *_names: contextlib.nullcontext(deaf_node),
        duration_s=lambda *_durations_s: 0.0,
        is_disturbed=lambda: False,
    )
    (attempt,) = [each for each in attempts(fleet.enabled_names) if name in each.name]
    with pytest.raises(NoProofError):
        attempt.gets_in(context)


def test_the_packets_of_an_attack_are_packets_of_mavlink() -> None:
    reader = common.MAVLink(None)
    kinds = [
        reader.parse_char(packet(number, payload, 7, 1)).get_type()
        for number, payload in ((HEARTBEAT, disarmed()), (SETUP_SIGNING, signing_key(7)))
    ]
    assert kinds == ["HEARTBEAT", "SETUP_SIGNING"]
