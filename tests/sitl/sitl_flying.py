"""Short hand for tests that fly emulated vehicles without sockets: build, wait for a condition,
send MAVLink.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from sitl.emulator.emulator import Emulator, VehicleSpec
from sitl.mavlink.codec import Decoder, Encoder, MavlinkMessage
from sitl.mavlink.link import Link
from sitl.mavlink.streams import ONBOARD_RATES_HZ
from sitl.physics.vehicle import VehicleProfile
from sitl.px4.versions import VERSIONS

SIH = VehicleProfile()
ARDRONE = VehicleProfile(
    mass_kg=0.51,
    hover_thrust_frac=0.75,
    attitude_wn_rad_s=6.0,
    attitude_zeta=0.7,
    drag_1_s=0.3,
    static_gain=0.9,
    tilt_bias_deg=1.5,
    thrust_noise_frac=0.01,
)
CLIENT = Encoder(245, 190)
EAST_WXYZ = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]


def emulator(
    *starts: tuple[float, float, float],
    profile: VehicleProfile = SIH,
    seed: int = 1,
    px4: str = "1.17",
) -> Emulator:
    """Vehicles at `starts` (fleet ENU), system ids from 1; one at the origin when none is given."""
    places = starts or ((0.0, 0.0, 0.0),)
    version = VERSIONS[px4]
    specs = [
        VehicleSpec(name=f"v{i}", system_id=i + 1, profile=profile, start_enu_m=place, px4=version)
        for i, place in enumerate(places)
    ]
    return Emulator(specs, seed=seed)


def until(
    emu: Emulator,
    condition: Callable[[], bool],
    timeout_s: float,
    each: Callable[[], None] | None = None,
) -> float:
    """Step until `condition`; the time that it took. Fails the test after `timeout_s` of simulated
    time.
    """
    start_s = emu.time_s
    while not condition():
        assert emu.time_s - start_s < timeout_s, f"not within {timeout_s} s"
        if each is not None:
            each()
        emu.step()
    return emu.time_s - start_s


def run_for(emu: Emulator, duration_s: float, each: Callable[[], None] | None = None) -> None:
    """Step for a time."""
    end_s = emu.time_s + duration_s
    until(emu, lambda: emu.time_s >= end_s - 1e-9, duration_s + 1.0, each)


def height_m(emu: Emulator, index: int = 0) -> float:
    """True height."""
    return float(-emu.world.vehicles.states.position_ned_m[index, 2])


def streamer(
    emu: Emulator, thrust_frac: float, attitude_wxyz: list[float] | None = None, index: int = 0
) -> Callable[[], None]:
    """A companion that sends an attitude setpoint at 50 Hz, level and eastward unless told."""

    def send() -> None:
        if emu.world.vehicles.steps % 5 == 0:
            emu.attitude_setpoint(index, attitude_wxyz or EAST_WXYZ, [0.0] * 3, thrust_frac, 7)

    return send


class Client:
    """A MAVLink client on the companion link of one vehicle."""

    def __init__(self, emu: Emulator, index: int = 0) -> None:
        self.link = Link(emu, index, ONBOARD_RATES_HZ)
        self.emulator = emu
        self._decoder = Decoder()

    def send(self, name: str, **fields: Any) -> list[MavlinkMessage]:
        """Send one message; what is answered at once."""
        return self.send_bytes(CLIENT.encode_named(name, **fields))

    def send_bytes(self, datagram: bytes) -> list[MavlinkMessage]:
        """Send any bytes; what is answered at once."""
        answers = self.link.receive(datagram)
        return [message for answer in answers for message in self._decoder.decode(answer)]

    def command(self, number: int, *params: float) -> list[int]:
        """COMMAND_LONG; the results of its acknowledgements, in order."""
        named = {f"param{place}": value for place, value in enumerate(params, start=1)}
        answers = self.send(
            "COMMAND_LONG", command=number, target_system=1, target_component=1, **named
        )
        return [
            m.fields["result"]
            for m in answers
            if m.name == "COMMAND_ACK" and m.fields["command"] == number
        ]

    def turn_satellites_off(self) -> None:
        """Let PX4 use external positions only."""
        self.send(
            "PARAM_SET", param_id=b"EKF2_GPS_CTRL", param_value=0.0, param_type=6, target_system=1
        )

    def collect(
        self, duration_s: float, each: Callable[[], None] | None = None
    ) -> list[MavlinkMessage]:
        """Everything that is streamed while time passes."""
        out: list[MavlinkMessage] = []

        def poll() -> None:
            if each is not None:
                each()
            for datagram in self.link.poll():
                out.extend(self._decoder.decode(datagram))

        run_for(self.emulator, duration_s, poll)
        return out
