"""The link against the emulated PX4 over UDP: frames, confirmations, parameters, and silence."""

from __future__ import annotations

import math
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from onboard.autopilot import Landed, LinkError, Snapshot
from onboard.config.fleet import load_fleet
from onboard.frames import Quaternion
from onboard.px4.mavsdk_link import Px4Link
from onboard.px4.required_params import RequiredParam, differences, required_params
from onboard.types import AttitudeSetpoint
from tests.oracles.rotation import quaternion_from_yaw, quaternion_multiply

FLEET = """
schema = 1
[fleet]
name = "link-test"
geofence_m = {{ x = [-50.0, 50.0], y = [-50.0, 50.0], z = [0.0, 20.0] }}
[types.sih]
hover_thrust_frac = 0.49
mocap_required = false
[defaults]
type = "sih"
[vehicles.solo]
system_id = 3
start_enu_m = [0.0, 0.0, 0.0]
agent = "tcp/127.0.0.1:{agent}"
autopilot = "udpin://127.0.0.1:{port}"
"""


def free_pair() -> int:
    """A UDP port that is free, and free again 40 higher, where the emulator sends from."""
    while True:
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as low,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as high,
        ):
            low.bind(("127.0.0.1", 0))
            port = int(low.getsockname()[1])
            try:
                high.bind(("127.0.0.1", port + 40))
            except (OSError, OverflowError):
                continue
            return port


def wait_for(link: Px4Link, accept: Callable[[Snapshot], bool], timeout_s: float = 8.0) -> Snapshot:
    """The first snapshot that is accepted."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        snapshot = link.snapshot()
        if accept(snapshot):
            return snapshot
        time.sleep(0.01)
    raise AssertionError(f"not seen within {timeout_s} s: {link.snapshot()}")


@pytest.fixture(scope="module")
def fleet_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("link") / "fleet.toml"
    path.write_text(FLEET.format(port=free_pair(), agent=free_pair()), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def link(fleet_file: Path) -> Iterator[Px4Link]:
    """A connected link to a running emulator."""
    command = [sys.executable, "-m", "sitl", "--fleet", str(fleet_file), "--no-bus"]
    vehicle = load_fleet(fleet_file).vehicles["solo"]
    found = Px4Link(vehicle.autopilot, vehicle.system_id)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("ready")
        try:
            found.start()
            deadline = time.monotonic() + 10.0
            while not found.connect(1.0):
                assert time.monotonic() < deadline
            yield found
        finally:
            found.stop()
            process.terminate()
            process.wait(5)


def test_the_snapshot_fills_with_everything_that_the_agent_reads(link: Px4Link) -> None:
    seen = wait_for(
        link,
        lambda s: (
            min(s.heartbeat_ns, s.attitude_ns, s.local_position_ns, s.landed_ns) > 0
            and min(s.battery_frac, s.position_accuracy_m) > 0.0
        ),
    )
    assert seen.system_id == 3
    assert seen.landed is Landed.ON_GROUND
    assert not seen.is_armed
    assert seen.mode == "HOLD"
    assert math.hypot(*seen.quaternion_enu_flu_wxyz) == pytest.approx(1.0, abs=1e-3)
    assert 10.0 < seen.battery_voltage_v < 20.0


def test_px4_tells_where_its_local_frame_lies_and_takes_an_origin_at_sea_level_for_a_mocap(
    link: Px4Link,
) -> None:
    deadline = time.monotonic() + 8.0
    while link.snapshot().global_origin is None and time.monotonic() < deadline:
        link.settle_global_origin(sets_ours=False)
        time.sleep(0.2)
    by_satellites = link.snapshot().global_origin
    assert by_satellites == pytest.approx((47.397742, 8.545594, 489.4), abs=1e-4)
    link.settle_global_origin(sets_ours=True)
    given = wait_for(link, lambda s: s.global_origin is not None and s.global_origin[2] == 0.0)
    assert given.global_origin == pytest.approx((47.397742, 8.545594, 0.0), abs=1e-4)


def test_the_stream_rates_are_raised(link: Px4Link) -> None:
    stamps = set()
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        stamps.add(link.snapshot().local_position_ns)
        time.sleep(0.002)
    assert len(stamps) > 38  # PX4's default is 30 Hz


def test_required_parameters_are_read_found_wrong_set_and_found_right(
    link: Px4Link, fleet_file: Path
) -> None:
    fleet = load_fleet(fleet_file)
    demands = required_params(fleet, fleet.vehicles["solo"]).values()
    required = {demand.name: demand.value for demand in demands}
    assert required.items() >= {"COM_OF_LOSS_T": 0.3, "COM_OBL_RC_ACT": 4}.items()
    before = differences(demands, link.read_params(required))
    assert [sentence.split()[2] for sentence in before][:2] == ["COM_OF_LOSS_T", "COM_OBL_RC_ACT"]
    link.apply_params(required)
    assert differences(demands, link.read_params(required)) == ()
    unknown = RequiredParam("NO_SUCH", 1, "")
    assert "did not send" in differences([unknown], link.read_params({"NO_SUCH": 1}))[0]


def test_a_flight_follows_the_setpoints_and_a_silent_loop_sends_none(link: Px4Link) -> None:
    yaw = 0.5 * math.pi  # PX4's north, where the emulated vehicle's nose points at the start
    level = quaternion_from_yaw(yaw)

    def fly(seconds: float, thrust_frac: float, q: Quaternion = level) -> None:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            link.send_attitude(AttitudeSetpoint(q, thrust_frac))
            time.sleep(0.02)

    link.apply_params({"COM_OF_LOSS_T": 0.3, "COM_OBL_RC_ACT": 4})
    fly(0.5, 0.0)
    link.set_offboard()
    fly(1.2, 0.0)
    assert link.snapshot().is_offboard
    link.arm()
    fly(1.2, 0.0)
    assert link.snapshot().is_armed
    fly(1.0, 0.56)
    fly(0.5, 0.48)
    assert link.snapshot().landed is Landed.IN_AIR
    assert link.snapshot().position_local_ned_m[2] < -0.3
    # tilt the thrust to fleet east: left of a nose that points north is west, so the left side has
    # to rise
    east = quaternion_multiply(level, (math.cos(0.08), math.sin(0.08), 0.0, 0.0))
    fly(0.8, 0.5, east)
    assert link.snapshot().velocity_local_ned_m_s[1] > 0.3
    # From here on nothing is sent although this process lives: PX4's own failsafe has to notice.
    wait_for(link, lambda s: s.mode == "LAND" and s.is_failsafe, 3.0)
    wait_for(link, lambda s: s.landed is Landed.ON_GROUND and not s.is_armed, 25.0)


def test_a_second_agent_on_the_same_port_is_refused_in_words(link: Px4Link) -> None:
    with pytest.raises(LinkError, match="is in use"):
        Px4Link(link.endpoint, 3).start()


def test_a_port_that_another_program_has_is_refused_in_words() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        endpoint = f"udpin://127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(LinkError, match="Another agent or ground station"):
            Px4Link(endpoint, 1).start()


def test_another_system_id_on_the_endpoint_is_refused(fleet_file: Path, tmp_path: Path) -> None:
    port = free_pair()
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET.format(port=port, agent=free_pair()), encoding="utf-8")
    command = [sys.executable, "-m", "sitl", "--fleet", str(path), "--no-bus"]
    found = Px4Link(f"udpin://127.0.0.1:{port}", 9)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        try:
            found.start()
            with pytest.raises(LinkError, match="system id 3, but the fleet file says 9"):
                found.connect(8.0)
        finally:
            found.stop()
            process.terminate()
            process.wait(5)


def test_nobody_there_is_no_error() -> None:
    found = Px4Link(f"udpin://127.0.0.1:{free_pair()}", 1)
    found.start()
    try:
        assert not found.connect(0.2)
        found.send_attitude(AttitudeSetpoint((1.0, 0.0, 0.0, 0.0), 0.5))
        assert found.snapshot() == Snapshot()
    finally:
        found.stop()
        found.stop()


def test_an_overflow_of_px4s_clock_is_no_restart() -> None:
    link = Px4Link("udpin://127.0.0.1:1", 3)
    overflow_ms = 1 << 32

    def read(clock_ms: int) -> Snapshot:
        payload = struct.pack("<I4f", clock_ms, 1.0, 0.0, 0.0, 0.0)
        link._unread["ATTITUDE_QUATERNION", b""] = (payload, time.monotonic_ns())
        return link.snapshot()

    for clock_ms in (overflow_ms - 40, overflow_ms - 20, 0, 20):
        seen = read(clock_ms)
    assert seen.px4_boot_ms == overflow_ms + 20
    assert read(overflow_ms - 10).px4_boot_ms == overflow_ms - 10, "a late message"
    assert read(40).px4_boot_ms == overflow_ms + 40
    assert read(90_000).px4_boot_ms == overflow_ms + 90_000
    assert seen.restarts == 0

    assert read(2_000).restarts == 1
    assert read(2_020).px4_boot_ms == 2_020
