"""What the emulator is started with and cannot do is refused in words, with exit status 2, and
disturbs nobody.
"""

from __future__ import annotations

import contextlib
import io
import socket
from pathlib import Path

import pytest

from groundstation.cli import main
from tests.clients.running import FLEET, free_ports, running_emulator


def refused(fleet: Path, *options: str) -> str:
    """What is said by an emulator that does not start."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said):
        assert main(["sitl", "--fleet", str(fleet), "--no-bus", *options]) == 2
    return said.getvalue()


def fleet_file(folder: Path, old: str = "", new: str = "") -> Path:
    """A sound fleet file with one thing changed."""
    companion, ground, agent, _ = free_ports()
    text = FLEET.format(companion=companion, ground=ground, agent=agent)
    assert old in text
    path = folder / "bad.toml"
    path.write_text(text.replace(old, new, 1) if old else text + new, encoding="utf-8")
    return path


def test_a_second_emulator_on_the_same_ports_is_refused_and_the_first_goes_on(
    tmp_path: Path,
) -> None:
    with running_emulator(tmp_path) as first:
        said = refused(first.fleet)
        assert str(first.companion + 40) in said
        assert "Is another emulator or a PX4 running?" in said
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
            listener.bind(("127.0.0.1", first.companion))
            listener.settimeout(10.0)
            assert listener.recv(4096)[:1] == b"\xfd"


SECOND = """
[vehicles.second]
system_id = 2
start_enu_m = [{east}, 0.0, 0.0]
agent = "tcp/127.0.0.1:{agent}"
autopilot = "udpin://127.0.0.1:{companion}"
"""


def test_a_vehicle_inside_another_is_refused_and_one_beside_it_is_not(tmp_path: Path) -> None:
    companion, _, agent, _ = free_ports()
    said = refused(
        fleet_file(tmp_path, new=SECOND.format(east=0.1, agent=agent, companion=companion))
    )
    assert "solo" in said
    assert "second" in said


def test_two_vehicles_on_one_port_are_refused(tmp_path: Path) -> None:
    _, _, agent, _ = free_ports()
    fleet = fleet_file(tmp_path)
    taken = (
        next(line for line in fleet.read_text().splitlines() if line.startswith("autopilot"))
        .split(":")[-1]
        .strip('"')
    )
    fleet.write_text(
        fleet.read_text() + SECOND.format(east=3.0, agent=agent, companion=taken), encoding="utf-8"
    )
    assert taken in refused(fleet)


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("drag_1_s = 1.0", "drag_1_s = 1.0\n[types.sih.sitl]\nmotor_lagg_s = 0.1", "motor_lagg_s"),
        ('type = "sih"', 'type = "unheard"', "unheard"),
        ("drag_1_s = 1.0", "drag_1_s = -1.0", "drag_1_s"),
        ("hover_thrust_frac = 0.49", "hover_thrust_frac = 1.7", "hover_thrust_frac"),
        ("udpin://127.0.0.1", "serial:///dev/ttyS0", "autopilot"),
        ("schema = 1", "schema = 1 1", "bad.toml"),
    ],
)
def test_an_unknown_or_impossible_profile_is_refused_by_its_key(
    tmp_path: Path, old: str, new: str, named: str
) -> None:
    assert named in refused(fleet_file(tmp_path, old, new))


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (("--vehicles", "nobody"), "nobody"),
        (("--seed", "-3"), "seed"),
        (("--gcs", "here:there"), "here:there"),
    ],
)
def test_an_option_that_makes_no_sense_is_refused(
    tmp_path: Path, options: tuple[str, ...], named: str
) -> None:
    assert named in refused(fleet_file(tmp_path), *options)
