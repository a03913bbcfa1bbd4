"""``covey check endpoint`` over UDP: a running emulator, and nobody at all."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from groundstation.cli import main
from tests.clients.running import running_emulator


def test_nobody_at_the_endpoint_is_exit_status_ten(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    assert main(["sitl-check", f"udpin://127.0.0.1:{port}", "--wait", "0.2"]) == 10
    assert "nobody answered" in capsys.readouterr().out


@pytest.mark.parametrize("host", ["255.255.255.255", "nowhere.invalid"])
def test_an_address_to_which_nothing_can_be_sent_is_exit_status_ten(
    host: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sitl-check", f"udpout://{host}:14580", "--wait", "0.2"]) == 10
    assert "nobody answered" in capsys.readouterr().out


@pytest.mark.parametrize("wait", ["nan", "inf", "-1", "601"])
def test_a_wait_out_of_bounds_is_refused_before_a_port_is_opened(
    wait: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sitl-check", "no-endpoint", "--wait", wait]) == 2
    assert f"--wait is {wait}; give 0 to 600 s." in capsys.readouterr().err


@pytest.mark.long
def test_the_command_checks_a_running_emulator_over_udp_and_prints_json(emulator_port: int) -> None:
    facts = [
        "quirk.heartbeat",
        "quirk.odometry-frames",
        "param.MPC_THR_HOVER",
        "ack",
        "mode.two-acks",
    ]
    covey = "import sys; from groundstation.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", covey, "sitl-check", f"udpin://127.0.0.1:{emulator_port}"]
    done = subprocess.run(
        [*command, "--json", "--only", *facts], capture_output=True, text=True, timeout=100
    )
    shown = json.loads(done.stdout)
    wrong = [
        fact
        for fact in shown["facts"]
        if fact["verdict"] == "differs" and fact["name"] != "ack.latency"
    ]
    assert wrong == []
    assert shown["agrees"] >= len(facts) - 1
    assert {"name", "section", "expected", "measured", "verdict", "reason"} <= set(
        shown["facts"][0]
    )
    assert re.search(r"agrees\s+param.MPC_THR_HOVER", done.stderr)


@pytest.mark.long
def test_an_emulator_of_v1_18_passes_as_what_it_reports_and_fails_as_another_version(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with running_emulator(tmp_path, "--px4", "1.18") as emulator:
        check = [
            "sitl-check",
            f"udpin://127.0.0.1:{emulator.companion}",
            "--only",
            "request.version",
            "param.MC_ROLL_P",
        ]
        assert main(check) == 0
        assert "it is PX4 v1.18" in capsys.readouterr().out
        assert main([*check, "--px4", "1.16"]) == 1
        assert "0 agrees, 2 differs" in capsys.readouterr().out
