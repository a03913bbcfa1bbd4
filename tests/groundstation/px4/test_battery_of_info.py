"""``covey px4 info`` shows one battery, also of a PX4 with several battery monitors."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink

from groundstation.client.autopilot_link import AutopilotLink
from groundstation.px4 import vehicle_info
from groundstation.px4.vehicle_links import VehicleLink
from onboard.config.fleet import load_fleet

_NO_CELL_MV = 65535
_NOT_KNOWN = -1
# charge [%] and voltage [mV] of a monitor to which nothing is connected
_EMPTY_PORT = (_NOT_KNOWN, _NO_CELL_MV)

StateOf = Callable[..., str]


@pytest.fixture
def state_of(monkeypatch: pytest.MonkeyPatch) -> Iterator[StateOf]:
    """Have PX4 report its battery monitors in turn, and return its state in words."""
    monkeypatch.setattr(vehicle_info, "_LISTEN_S", 0.5)
    monkeypatch.setattr(vehicle_info, "_AGAIN_S", 0.1)
    vehicle = load_fleet(Path("configs/fleets/paper.toml")).vehicles["mav1"]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as px4:
        px4.bind(("127.0.0.1", 0))
        link = AutopilotLink(f"udpout://127.0.0.1:{px4.getsockname()[1]}", vehicle.system_id)

        def state(*reports: tuple[int, int]) -> str:
            mav = mavlink.MAVLink(None, vehicle.system_id, 1)

            def send() -> None:
                _, ground = px4.recvfrom(1000)  # the request of the version
                for monitor, (charge_pct, voltage_mv) in enumerate(reports):
                    voltages_mv = [voltage_mv] + [_NO_CELL_MV] * 9
                    report = mav.battery_status_encode(
                        monitor, 0, 0, 2500, voltages_mv, -1, -1, -1, charge_pct
                    )
                    px4.sendto(report.pack(mav), ground)

            sender = threading.Thread(target=send)
            sender.start()
            try:
                return vehicle_info.ask(VehicleLink(vehicle, link)).facts["state"]
            finally:
                sender.join(5.0)

        try:
            yield state
        finally:
            link.stop()


def test_an_empty_port_hides_no_battery(state_of: StateOf) -> None:
    assert "battery 80%, 16.0 V" in state_of((80, 16_000), _EMPTY_PORT)


def test_a_charge_that_px4_does_not_know_is_said_in_words(state_of: StateOf) -> None:
    assert "battery charge not said, 16.0 V" in state_of((_NOT_KNOWN, 16_000))
