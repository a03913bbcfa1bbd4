"""Ground truth of real PX4s with their built-in simulator (SIH), published on the bus.

PX4's SIH sends its true state on a separate link, from port 19450 + N to 19410 + N, where N is the
system id - 1. With it a flight of real PX4s can be judged like a flight of emulated ones. With
`--mocap` it also acts as a motion capture for agents that need poses.

This is the command `covey sitl truth`. It replaces the `server.py` of an emulated flight. It has
the same node and topics, but no emulator.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np

from onboard.bus.pose_publisher import PosePublisher
from onboard.bus.schema import MocapPose, Truth
from onboard.bus.session import BusSession
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, Origin, Vehicle
from onboard.end_signals import end_signals
from sitl.mavlink.codec import ID_BY_NAME, Decoder, Encoder, text_of
from sitl.mavlink.endpoints import StartError
from sitl.physics.frames import enu_flu_from_ned_frd
from sitl.server import simulator_bus, take_precedence

_FIRST_PORT = 19410
_STATE = "HIL_STATE_QUATERNION"
_ACTUATORS = "HIL_ACTUATOR_CONTROLS"
_SET_MESSAGE_INTERVAL = 511
_PERIOD_US = 10_000.0  # requested period of the states; PX4 then sends 99 Hz
_REQUEST_AGAIN_S = 2.0  # time between two requests for the states
_SHOW_S = 2.0  # time between two checks for silent vehicles

_MOCAP_PERIOD_S = 0.019  # least time between two poses; every second state becomes one (50 Hz)
_MOCAP_NOISE_M = 0.002

# A vehicle that is lower and slower than this counts as being on the ground.
_GROUND_M = 0.10
_STILL_M_S = 0.10

# First contact of a flight: the ground of the simulator stops a vehicle from one state to the next.
_FLIGHT_M = 0.5  # least height of a flight
_CONTACT_M = 0.4  # largest height of a contact
_STOPPED_M_S = 0.05  # a slower vehicle has stopped
_CONTACT_NS = 50_000_000  # the contact speed is the largest speed in this time before it

HOME_PARAMS = ("SIH_LOC_LAT0", "SIH_LOC_LON0", "SIH_LOC_H0")
_HOME_AGAIN_S = 0.3  # time between two requests for these parameters
_HOME_WITHIN_S = 3.0  # time to wait for these parameters

_EARTH_RADIUS_M = 6_371_000.0

Vec3 = tuple[float, float, float]


def east_north_m(origin: tuple[float, float], position: tuple[float, float]) -> tuple[float, float]:
    """Return the distances by which a position on Earth is east and north of an origin.

    Both are latitude and longitude in degrees. The result is accurate up to a few kilometres.
    """
    latitude_deg, longitude_deg = position
    origin_latitude_deg, origin_longitude_deg = origin
    north_rad = math.radians(latitude_deg - origin_latitude_deg)
    east_rad = math.radians(longitude_deg - origin_longitude_deg)
    middle_rad = math.radians(0.5 * (latitude_deg + origin_latitude_deg))
    return _EARTH_RADIUS_M * east_rad * math.cos(middle_rad), _EARTH_RADIUS_M * north_rad


@dataclass(slots=True)
class Body:
    """The true state of one vehicle in the fleet frame.

    States are relative to the start of PX4's simulator, which comes from PX4's parameters
    (:data:`HOME_PARAMS`). The result therefore does not depend on when this program starts, or on
    how far a vehicle has sunk into the ground. If the fleet has no global origin, the start of the
    simulator is the start of the vehicle in the fleet file. All simulated vehicles may then start
    at the same position on Earth.
    """

    vehicle: Vehicle
    origin: Origin | None  # global origin of the fleet
    home: dict[str, float] = field(default_factory=dict)  # values of HOME_PARAMS that PX4 has sent
    # Start of the simulator: latitude [deg], longitude [deg], altitude [m].
    _begin: Vec3 | None = field(default=None)

    # Greatest height of the present flight [m], and recent stamps and climb rates.
    _highest_m: float = -math.inf
    _climbs: deque[tuple[int, float]] = field(default_factory=deque)
    _touchdowns: int = 0
    _touchdown_m_s: float = 0.0

    def missing(self) -> tuple[str, ...]:
        """Return the parameters that PX4 has not sent yet."""
        return tuple(name for name in HOME_PARAMS if name not in self.home)

    def truth(self, state: dict[str, Any], stamp_ns: int) -> Truth:
        """Return the truth from the fields of HIL_STATE_QUATERNION."""
        position = (state["lat"] * 1e-7, state["lon"] * 1e-7, state["alt"] * 1e-3)
        if self._begin is None:
            self._begin = self._start_of_simulator(position)

        latitude_deg, longitude_deg, altitude_m = position
        begin_latitude_deg, begin_longitude_deg, begin_altitude_m = self._begin
        start_east, start_north, start_up = self.vehicle.start_enu_m
        if self.origin is None:
            begin = (begin_latitude_deg, begin_longitude_deg)
            east, north = east_north_m(begin, (latitude_deg, longitude_deg))
            east += start_east
            north += start_north
        else:
            origin = (self.origin.latitude_deg, self.origin.longitude_deg)
            east, north = east_north_m(origin, (latitude_deg, longitude_deg))
        up = altitude_m - begin_altitude_m + start_up

        climb_m_s = -0.01 * state["vz"]
        velocity = (0.01 * state["vy"], 0.01 * state["vx"], climb_m_s)
        attitude_ned_frd = np.array(state["attitude_quaternion"], dtype=np.float64)
        w, x, y, z = enu_flu_from_ned_frd(attitude_ned_frd).tolist()

        is_low = up - start_up < _GROUND_M
        is_still = math.hypot(*velocity) < _STILL_M_S
        self._look_for_contact(stamp_ns, up - start_up, climb_m_s)
        return Truth(
            vehicle=self.vehicle.name,
            stamp_ns=stamp_ns,
            position_enu_m=(east, north, up),
            velocity_enu_m_s=velocity,
            quaternion_enu_flu_wxyz=(w, x, y, z),
            is_on_ground=is_low and is_still,
            is_collided=False,  # not known: the simulators of different PX4s are independent
            touchdowns=self._touchdowns,
            touchdown_m_s=self._touchdown_m_s,
        )

    def _look_for_contact(self, stamp_ns: int, height_m: float, climb_m_s: float) -> None:
        """Count a contact that ends a flight, and store its speed."""
        self._highest_m = max(self._highest_m, height_m)
        self._climbs.append((stamp_ns, climb_m_s))
        while True:
            oldest_ns, _ = self._climbs[0]
            if stamp_ns - oldest_ns <= _CONTACT_NS:
                break
            self._climbs.popleft()

        fastest_m_s = -min(climb for _, climb in self._climbs)
        has_stopped = abs(climb_m_s) < _STOPPED_M_S < fastest_m_s
        is_near_ground = height_m < _CONTACT_M
        if self._highest_m > _FLIGHT_M and is_near_ground and has_stopped:
            self._touchdowns += 1
            self._touchdown_m_s = fastest_m_s
            self._highest_m = height_m

    def _start_of_simulator(self, position: Vec3) -> Vec3:
        """Return the start of the simulator, or a position if PX4 does not send its parameters."""
        if self.missing():
            return position
        return cast(Vec3, tuple(self.home[name] for name in HOME_PARAMS))


class Listener(asyncio.DatagramProtocol):
    """The truth link of one PX4, which requests the rate of the states and passes each on.

    Args:
        system_id: MAVLink system id of the PX4.
        take: function that receives the fields of a state and the time of its arrival [ns].
        body: body whose home has to be known before states are passed on; None: no home is
            requested.

    Attributes:
        heard: number of states that have arrived.
    """

    def __init__(
        self, system_id: int, take: Callable[[dict[str, Any], int], None], body: Body | None = None
    ) -> None:
        self.heard = 0
        self._system_id = system_id
        self._take = take
        self._body = body
        self._decoder = Decoder()
        self._encoder = Encoder(system_id=255, component_id=190)
        self._first_ns = 0  # time of the first state
        self._home_requested_ns = 0
        self._requested_s = -math.inf  # time of the last request for the rate
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Store the transport, to send to PX4."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        """Receive one datagram of PX4."""
        now_ns = time.monotonic_ns()
        for message in self._decoder.decode(data):
            if message.system_id != self._system_id:
                continue

            if message.name == _STATE:
                self._take_state(message.fields, addr, now_ns)
            elif message.name == "PARAM_VALUE" and self._body is not None:
                name = text_of(message.fields["param_id"])
                if name in HOME_PARAMS:
                    self._body.home[name] = message.fields["param_value"]
            elif message.name == _ACTUATORS:
                # PX4 sends this message by default, when it has just started or has not received
                # the request yet.
                self._request_rates(addr, now_ns)

    def _take_state(self, fields: dict[str, Any], addr: tuple[str | Any, int], now_ns: int) -> None:
        self.heard += 1
        if self._first_ns == 0:
            self._first_ns = now_ns
        if self._has_home(addr, now_ns):
            self._take(fields, now_ns)

    def _request_rates(self, addr: tuple[str | Any, int], now_ns: int) -> None:
        if now_ns * 1e-9 - self._requested_s <= _REQUEST_AGAIN_S:
            return
        self._requested_s = now_ns * 1e-9
        self._set_interval(addr, ID_BY_NAME[_STATE], _PERIOD_US)
        self._set_interval(addr, ID_BY_NAME[_ACTUATORS], -1.0)  # PX4 then stops sending it

    def _has_home(self, addr: tuple[str | Any, int], now_ns: int) -> bool:
        """Return whether states are passed on: home is known, or did not arrive in time."""
        if self._body is None:
            return True
        missing = self._body.missing()
        if not missing or now_ns - self._first_ns > _HOME_WITHIN_S * 1e9:
            return True

        is_due = now_ns - self._home_requested_ns > _HOME_AGAIN_S * 1e9
        if is_due and self._transport is not None:
            self._home_requested_ns = now_ns
            for name in missing:
                request = self._encoder.encode_named(
                    "PARAM_REQUEST_READ",
                    target_system=self._system_id,
                    target_component=1,
                    param_id=name.encode(),
                    param_index=-1,
                )
                self._transport.sendto(request, addr)
        return False

    def _set_interval(self, addr: tuple[str | Any, int], message_id: int, period_us: float) -> None:
        assert self._transport is not None
        command = self._encoder.encode_named(
            "COMMAND_LONG",
            target_system=self._system_id,
            target_component=1,
            command=_SET_MESSAGE_INTERVAL,
            param1=float(message_id),
            param2=period_us,
        )
        self._transport.sendto(command, addr)


@dataclass(slots=True)
class TruthRelay:
    """Relay of the truth of one vehicle to the bus, with poses of a motion capture if requested."""

    bus: BusSession
    body: Body
    with_mocap: bool
    boot_id: int
    _sequence: int = 0
    _pose_s: float = -math.inf
    _poses: PosePublisher = field(init=False)
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._poses = PosePublisher(self.bus)
        # different noise for each vehicle: the same would leave no error of relative positions
        self._rng = np.random.default_rng(self.body.vehicle.system_id)

    def take(self, state: dict[str, Any], stamp_ns: int) -> None:
        """Publish one state."""
        truth = self.body.truth(state, stamp_ns)
        vehicle = self.body.vehicle
        self.bus.publish(Topic.TRUTH, vehicle.name, truth)

        now_s = stamp_ns * 1e-9
        if not self.with_mocap or now_s - self._pose_s < _MOCAP_PERIOD_S:
            return
        self._pose_s = now_s
        self._sequence += 1

        # Add noise, because agents reject poses that do not change at all as frozen.
        x, y, z = (truth.position_enu_m + self._rng.normal(0.0, _MOCAP_NOISE_M, 3)).tolist()
        pose = MocapPose(
            body=vehicle.mocap_body or vehicle.name,
            boot_id=self.boot_id,
            sequence=self._sequence,
            stamp_ns=stamp_ns,
            is_tracked=True,
            position_enu_m=(x, y, z),
            quaternion_enu_flu_wxyz=truth.quaternion_enu_flu_wxyz,
        )
        self._poses.publish(pose)


async def serve(
    fleet: FleetConfig, names: Sequence[str], bus: BusSession, *, with_mocap: bool
) -> None:
    """Relay the truth of vehicles to a bus until a signal asks to end; see :func:`run`."""
    loop = asyncio.get_running_loop()
    stopped = asyncio.Event()
    for number in end_signals():
        loop.add_signal_handler(number, stopped.set)

    boot_id = time.time_ns() & 0x7FFFFFFF
    ports = {name: _FIRST_PORT + fleet.vehicles[name].system_id - 1 for name in names}
    listeners: dict[str, Listener] = {}
    transports = []

    bus.start()
    try:
        for name, port in ports.items():
            vehicle = fleet.vehicles[name]
            body = Body(vehicle, fleet.fleet.global_origin)
            relay = TruthRelay(bus, body, with_mocap, boot_id)
            listener = Listener(vehicle.system_id, relay.take, body)
            try:
                transport, _ = await loop.create_datagram_endpoint(
                    lambda listener=listener: listener,  # type: ignore[misc]
                    ("127.0.0.1", port),
                )
            except OSError as error:
                raise StartError(
                    f"UDP port {port} of {name} is taken ({error.strerror}). "
                    "Stop the program that listens there."
                ) from None
            listeners[name] = listener
            transports.append(transport)

        listening = ", ".join(f"{name} at {port}" for name, port in ports.items())
        print(f"listening: {listening}", flush=True)
        await _show_silence(listeners, stopped)
    finally:
        for transport in transports:
            transport.close()
        bus.stop()


async def _show_silence(listeners: dict[str, Listener], stopped: asyncio.Event) -> None:
    """Print for each vehicle when it becomes silent and when it is heard again, until stopped."""
    was_heard = dict.fromkeys(listeners, False)
    while not stopped.is_set():
        counts = {name: listener.heard for name, listener in listeners.items()}
        try:
            await asyncio.wait_for(stopped.wait(), _SHOW_S)
        except TimeoutError:
            for name, listener in listeners.items():
                is_heard = listener.heard > counts[name]
                if is_heard == was_heard[name]:
                    continue
                was_heard[name] = is_heard
                if is_heard:
                    print(f"{name}: heard", flush=True)
                else:
                    print(f"{name}: silent", flush=True)


def run(fleet: FleetConfig, names: Sequence[str], *, with_mocap: bool) -> None:
    """Relay the truth of vehicles until a signal asks to end.

    Raises:
        BusError: the bus cannot be opened.
        StartError: a port is taken.
    """
    take_precedence()
    asyncio.run(serve(fleet, names, simulator_bus(fleet, "sitl-truth"), with_mocap=with_mocap))
