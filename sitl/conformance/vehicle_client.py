"""A client of one vehicle, which sends and receives messages, and sends setpoints on time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import common

from sitl.conformance.endpoint import Port, Recording, VehicleClock
from sitl.conformance.measurements import NOT_MEASURED
from sitl.conformance.parameter_client import ParameterClient

MODES = {
    65536: "MANUAL",
    131072: "ALTCTL",
    196608: "POSCTL",
    393216: "OFFBOARD",
    458752: "STABILIZED",
    33816576: "AUTO.TAKEOFF",
    50593792: "AUTO.LOITER",
    67371008: "AUTO.MISSION",
    84148224: "AUTO.RTL",
    100925440: "AUTO.LAND",
}
MODE_NUMBERS = {name: number for number, name in MODES.items()}


def _words(enum: str) -> dict[int, str]:
    """Return the names in an enumeration of MAVLink, without the name of the enumeration."""
    return {
        number: entry.name.removeprefix(f"{enum}_") for number, entry in common.enums[enum].items()
    }


STATUS = _words("MAV_STATE")
RESULTS = _words("MAV_RESULT")
LANDED = _words("MAV_LANDED_STATE")

# Numbers of commands.
LAND = 21
TAKEOFF = 22
SET_MODE = 176
ARM = 400
SET_INTERVAL = 511
REQUEST = 512

MAV_RESULT_ACCEPTED = 0
ARMED = 0x80  # bit of HEARTBEAT.base_mode
FORCE = 21196.0  # parameter 2 of ARM that forces disarming
ATTITUDE_AND_THRUST = 7  # type mask: body rates are ignored
SILENCE = "silence"  # stands for a missing acknowledgement

_PREARM = 0x10000000  # bit of SYS_STATUS
_SILENT_S = 5.0  # time without a datagram after which a vehicle is gone
_ANSWER_S = 0.3  # time to wait for acknowledgements
_ANSWER_REAL_S = 0.12  # minimum real time to wait for acknowledgements
_INTERVAL_ANSWER_S = 0.1  # time to wait for the acknowledgement of an interval
_VERSION_ATTEMPTS = 3
_HEARTBEAT_S = 1.4  # longest time between two heartbeats
# longest waits for a datagram, after which the condition of `listen` or the duties are checked
_LISTEN_WAIT_S = 0.05
_LONGEST_WAIT_S = 0.2
# A shorter pause would make the loop of `wait` busy, a longer one would make setpoints late.
_SHORTEST_WAIT_S = 0.0002
_CLASSES = {kind.msgname: kind for kind in common.mavlink_map.values()}

Quaternion = tuple[float, float, float, float]


class Gone(RuntimeError):
    """No datagram has arrived for seconds, so the vehicle is gone."""


class Stuck(RuntimeError):
    """The vehicle did not reach a state that the next measurement needs."""


class ClientIdentity(NamedTuple):
    """Identity of a client in MAVLink."""

    system_id: int
    component_id: int
    mav_type: int


class EulerAngles(NamedTuple):
    """Angles of an attitude in ATTITUDE [rad]."""

    roll: float
    pitch: float
    yaw: float


class ReceivedText(NamedTuple):
    """A text of the vehicle, put together from its pieces."""

    at_s: float  # time of the first piece, in the time of the vehicle
    severity: int  # MAV_SEVERITY
    words: str
    pieces: int


# Stands for a missing text.
NO_TEXT = ReceivedText(at_s=math.inf, severity=-1, words="", pieces=0)


@dataclass(slots=True)
class Signature:
    """Signature of a client's messages."""

    key: bytes
    link_id: int
    timestamp: int  # timestamp of the next message [10 us since 2015]


@dataclass(slots=True)
class Duty:
    """A message that the client sends periodically while it waits."""

    period_s: float
    act: Callable[[], None] | None = None  # function that sends the message; None: a pause
    due_s: float = 0.0  # time of the next message


def quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """Return the attitude NED <- FRD, wxyz, from roll, pitch, yaw (z-y'-x'')."""
    cr = math.cos(roll_rad / 2)
    sr = math.sin(roll_rad / 2)
    cp = math.cos(pitch_rad / 2)
    sp = math.sin(pitch_rad / 2)
    cy = math.cos(yaw_rad / 2)
    sy = math.sin(yaw_rad / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def wrap(angle_rad: float) -> float:
    """Return an angle in (-pi, pi]."""
    return math.atan2(math.sin(angle_rad), math.cos(angle_rad))


class VehicleClient:
    """Client that flies one vehicle and sends requests.

    Times are those of the vehicle, at any pace of its simulator.

    Args:
        port: port for datagrams to and from the vehicle.

    Attributes:
        is_ground_station: whether the client is a ground station; otherwise it is a companion.
        moves_first_sender: whether the first datagrams go out from another port than the one that
            listens. A vehicle that answers its first sender only is then locked to a port that is
            gone.
        signature: signature of sent messages; None: messages are not signed.
        heartbeat_duty: duty that sends heartbeats.
        setpoint_duty: duty that sends setpoints.
        vision_duty: duty that sends external positions, or the sticks of a pilot.
        params: client for parameters.
    """

    def __init__(self, port: Port) -> None:
        self.port = port
        self.clock = VehicleClock()
        self.received = Recording()
        self.system_id = 0
        self.is_ground_station = False
        self.moves_first_sender = False
        self.signature: Signature | None = None
        self.heartbeat_duty = Duty(0.5)
        self.setpoint_duty = Duty(0.02)
        self.vision_duty = Duty(0.02)
        self._heard_s = port.now_s()
        self._sequence = 0
        self.params = ParameterClient(self)

    # -- time --------------------------------------------------------------------------------------

    @property
    def now_s(self) -> float:
        """Present time of the vehicle."""
        return self.clock.now_s(self.port.now_s())

    def listen(self, timeout_s: float, until: Callable[[], bool]) -> bool:
        """Receive without sending, by the clock of the port.

        Args:
            timeout_s: longest time.
            until: condition that ends the reception.

        Returns:
            whether the condition holds before the time is over.
        """
        end_s = self.port.now_s() + timeout_s
        while not until():
            if self.port.now_s() >= end_s:
                return False
            self._receive(_LISTEN_WAIT_S)
        self._heard_s = self.port.now_s()
        return True

    def wait(self, duration_s: float, until: Callable[[], bool] | None = None) -> bool:
        """Wait for a time, or until a condition holds; meanwhile send the messages of the duties.

        Returns:
            whether the condition holds.

        Raises:
            Gone: the vehicle is silent.
        """
        end_s = self.now_s + duration_s
        duties = (self.heartbeat_duty, self.setpoint_duty, self.vision_duty)
        while True:
            if until is not None and until():
                return True
            now_s = self.now_s
            if now_s >= end_s:
                return False

            wake_s = end_s
            for duty in duties:
                if duty.act is None:
                    continue
                if now_s >= duty.due_s:
                    duty.act()
                    duty.due_s = max(duty.due_s + duty.period_s, now_s)
                wake_s = min(wake_s, duty.due_s)

            self._receive(max(_SHORTEST_WAIT_S, (wake_s - now_s) / self.clock.pace))

    def _receive(self, timeout_s: float) -> None:
        datagrams = self.port.receive(min(timeout_s, _LONGEST_WAIT_S))
        port_s = self.port.now_s()
        for datagram in datagrams:
            self.received.take(datagram, self.clock, port_s)
        if datagrams:
            self._heard_s = port_s
        elif port_s - self._heard_s > _SILENT_S and self.received.datagrams:
            raise Gone

    # -- state of the vehicle ----------------------------------------------------------------------

    def newest(self, name: str) -> Any:
        """Return the newest message with a name.

        Raises:
            Stuck: no such message has arrived yet.
        """
        packet = self.received.newest(name)
        if packet is None:
            raise Stuck(f"no {name} came")
        return packet.message

    @property
    def mode(self) -> str:
        """Mode of the newest heartbeat."""
        number = self.newest("HEARTBEAT").custom_mode
        return MODES.get(number, str(number))

    @property
    def status(self) -> str:
        """System status of the newest heartbeat."""
        number = self.newest("HEARTBEAT").system_status
        return STATUS.get(number, str(number))

    @property
    def is_armed(self) -> bool:
        """Whether the vehicle is armed in the newest heartbeat."""
        return bool(self.newest("HEARTBEAT").base_mode & ARMED)

    @property
    def arming_state(self) -> str:
        """The word "armed" or "disarmed", by the newest heartbeat."""
        if self.is_armed:
            return "armed"
        return "disarmed"

    @property
    def landed(self) -> str:
        """Newest landed state."""
        return LANDED.get(self.newest("EXTENDED_SYS_STATE").landed_state, "?")

    def shows_ready(self) -> bool:
        """Return whether SYS_STATUS has the prearm bit."""
        packet = self.received.newest("SYS_STATUS")
        return packet is not None and bool(packet.message.onboard_control_sensors_health & _PREARM)

    @property
    def prearm_bit(self) -> str:
        """State of the prearm bit of SYS_STATUS as text."""
        if self.shows_ready():
            return "set"
        return "not set"

    def next_heartbeat(self, count: int = 1) -> None:
        """Wait for the next heartbeats."""
        since_s = self.now_s
        self.wait(
            _HEARTBEAT_S * count, lambda: len(self.received.of("HEARTBEAT", since_s)) >= count
        )

    def texts(self, since_s: float) -> list[ReceivedText]:
        """Return the texts since a time."""
        texts: list[ReceivedText] = []
        index_by_id: dict[int, int] = {}  # index in the list by id of the text

        for packet in self.received.of("STATUSTEXT", since_s):
            piece = packet.message
            # PX4's first text has the id 0. It too can have several pieces.
            continues_text = bool(piece.chunk_seq) and piece.id in index_by_id

            if continues_text:
                index = index_by_id[piece.id]
                text = texts[index]
                texts[index] = text._replace(words=text.words + piece.text, pieces=text.pieces + 1)
            else:
                index_by_id[piece.id] = len(texts)
                texts.append(
                    ReceivedText(
                        at_s=packet.at_s, severity=piece.severity, words=piece.text, pieces=1
                    )
                )
        return texts

    def text(self, start: str, since_s: float, wait_s: float = 0.0) -> ReceivedText | None:
        """Return the first text with a beginning since a time; None without it.

        Args:
            start: beginning of the text.
            since_s: time from which texts count.
            wait_s: longest time to wait for the text.
        """

        def first() -> ReceivedText | None:
            for text in self.texts(since_s):
                if text.words.startswith(start):
                    return text
            return None

        self.wait(wait_s, lambda: first() is not None)
        return first()

    def quote(self, start: str, since_s: float) -> str:
        """Return the first text with a beginning since a time, in quotes; "none" without it."""
        text = self.text(start, since_s)
        if text is None:
            return "none"
        return repr(text.words)

    def delay_s(self, start: str, since_s: float, wait_s: float = 0.0) -> float:
        """Return the time from `since_s` to a text with a beginning; NOT_MEASURED without it."""
        text = self.text(start, since_s, wait_s)
        if text is None:
            return NOT_MEASURED
        return text.at_s - since_s

    def first_text(self, since_s: float) -> str:
        """Return the first text since a time, in quotes; "none" without a text."""
        texts = self.texts(since_s)
        if not texts:
            return "none"
        return repr(texts[0].words)

    # -- sending -----------------------------------------------------------------------------------

    @property
    def identity(self) -> ClientIdentity:
        """Identity of a ground station, or of a companion with the vehicle's system id."""
        if self.is_ground_station:
            return ClientIdentity(system_id=245, component_id=190, mav_type=6)  # MAV_TYPE_GCS
        # MAV_TYPE_ONBOARD_CONTROLLER
        return ClientIdentity(system_id=self.system_id, component_id=195, mav_type=18)

    def pack(self, name: str, **fields: Any) -> bytes:
        """Return the bytes of a message; numbers that are left out are 0."""
        kind = _CLASSES[name]
        zeros = {
            field: 0
            for field, length in zip(kind.ordered_fieldnames, kind.array_lengths, strict=True)
            if not length
        }
        message = kind(**(zeros | fields))

        identity = self.identity
        mav = common.MAVLink(None, srcSystem=identity.system_id, srcComponent=identity.component_id)
        self._sequence = (self._sequence + 1) & 0xFF
        mav.seq = self._sequence
        if self.signature is not None:
            mav.signing.secret_key = self.signature.key
            mav.signing.sign_outgoing = True
            mav.signing.link_id = self.signature.link_id
            mav.signing.timestamp = self.signature.timestamp
            self.signature.timestamp += 1
        return bytes(message.pack(mav))

    def send(self, name: str, **fields: Any) -> None:
        """Send one message."""
        self.port.send(self.pack(name, **fields))

    def pack_heartbeat(self) -> bytes:
        """Return a heartbeat of the present identity."""
        return self.pack(
            "HEARTBEAT",
            type=self.identity.mav_type,
            autopilot=8,  # MAV_AUTOPILOT_INVALID: the sender is not an autopilot
            system_status=4,  # MAV_STATE_ACTIVE
            mavlink_version=3,
        )

    def send_heartbeat(self) -> None:
        """Send one heartbeat of the present identity."""
        self.port.send(self.pack_heartbeat())

    def greet(self, *, as_ground_station: bool) -> None:
        """Start sending heartbeats, as a ground station or as a companion."""
        self.is_ground_station = as_ground_station
        self.heartbeat_duty.act = self.send_heartbeat
        self.heartbeat_duty.due_s = 0.0

    def command(
        self, number: int, *params: float, target: int | None = None, within_s: float = _ANSWER_S
    ) -> str:
        """Send a COMMAND_LONG; return its acknowledgements as text, in order."""
        since_s = self.now_s
        self.send_command(number, *params, target=target)
        return self.acks(number, since_s, within_s)

    def send_command(self, number: int, *params: float, target: int | None = None) -> None:
        """Send a COMMAND_LONG without waiting, to the vehicle or another target."""
        if target is None:
            target = self.system_id
        named = {f"param{index}": value for index, value in enumerate(params, start=1)}
        self.send(
            "COMMAND_LONG",
            target_system=target,
            target_component=1,
            command=number,
            **named,
        )

    def acks(self, number: int, since_s: float, within_s: float = _ANSWER_S) -> str:
        """Wait, then return the acknowledgements of a command since a time."""
        # A busy machine needs some real time to answer, whatever the pace of the vehicle.
        self.wait(max(within_s, _ANSWER_REAL_S * self.clock.pace))

        results: list[str] = []
        for packet in self.received.of("COMMAND_ACK", since_s):
            ack = packet.message
            if ack.command == number:
                results.append(RESULTS.get(ack.result, str(ack.result)))
        return ", ".join(results) or SILENCE

    def reported_version(self) -> tuple[int, int] | None:
        """Return major and minor number of AUTOPILOT_VERSION; None after unanswered requests."""
        for _ in range(_VERSION_ATTEMPTS):
            self.command(REQUEST, float(common_id("AUTOPILOT_VERSION")))
            packet = self.received.newest("AUTOPILOT_VERSION")
            if packet is not None and packet.message.flight_sw_version:
                number = packet.message.flight_sw_version
                major, minor, _, _ = number.to_bytes(4, "big")
                return major, minor
        return None

    def set_mode(self, mode: str) -> str:
        """Send a DO_SET_MODE; return its acknowledgements."""
        sub_mode, main_mode, _, _ = MODE_NUMBERS[mode].to_bytes(4, "big")
        custom_mode_enabled = 1.0  # the parameters are a mode of PX4
        return self.command(SET_MODE, custom_mode_enabled, float(main_mode), float(sub_mode))

    def interval(self, name_or_id: str | int, hz: float) -> str:
        """Send a SET_MESSAGE_INTERVAL; return its acknowledgements.

        Args:
            name_or_id: name or number of the message.
            hz: rate; 0: the default rate.
        """
        message_id = name_or_id
        if isinstance(message_id, str):
            message_id = common_id(message_id)

        interval_us = 0.0
        if hz:
            interval_us = 1e6 / hz
        return self.command(
            SET_INTERVAL, float(message_id), interval_us, within_s=_INTERVAL_ANSWER_S
        )

    # -- setpoints ---------------------------------------------------------------------------------

    def attitude(
        self,
        q: Quaternion,
        thrust: float,
        *,
        mask: int = ATTITUDE_AND_THRUST,
        rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
        target: int | None = None,
    ) -> None:
        """Send one SET_ATTITUDE_TARGET, to the vehicle or another target."""
        if target is None:
            target = self.system_id
        roll_rate, pitch_rate, yaw_rate = rates
        self.send(
            "SET_ATTITUDE_TARGET",
            target_system=target,
            target_component=1,
            type_mask=mask,
            q=list(q),
            body_roll_rate=roll_rate,
            body_pitch_rate=pitch_rate,
            body_yaw_rate=yaw_rate,
            thrust=thrust,
        )

    def stream(self, act: Callable[[], None] | None, hz: float = 50.0) -> None:
        """Start sending a setpoint periodically; None stops.

        Args:
            act: function that sends the setpoint.
            hz: rate.
        """
        self.setpoint_duty.act = act
        self.setpoint_duty.period_s = 1.0 / hz
        self.setpoint_duty.due_s = 0.0

    def euler(self) -> EulerAngles:
        """Return the newest angles."""
        message = self.newest("ATTITUDE")
        return EulerAngles(roll=message.roll, pitch=message.pitch, yaw=message.yaw)


def other_system_id(client: VehicleClient) -> int:
    """Return a valid system id that differs from that of the vehicle."""
    return client.system_id % 250 + 3


def common_id(name: str) -> int:
    """Return the number of a message."""
    return int(_CLASSES[name].id)
