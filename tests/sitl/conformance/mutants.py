"""Emulators that deviate from PX4 on purpose, one way each, and the fact that has to notice.

A mutant changes the vehicle, a parameter behind the client's back, or what passes on the wire: an
emulator that refuses a NaN is one that never sees it, one that shows heartbeats on change is one
that sends them twice.
"""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common

from sitl.physics.vehicle import VehicleProfile
from tests.sitl.conformance.virtual import Wires

IDS = {kind.msgname: number for number, kind in common.mavlink_map.items()}
Edit = Callable[[Any], Sequence[Any]]


def _id_of(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little")


def editing(**edits: Edit) -> Callable[[bytes], Sequence[bytes]]:
    """A change of frames: each message named is given, decoded, to its function, which returns what
    to pass on.
    """
    by_id = {IDS[name]: edit for name, edit in edits.items()}

    def change(frame: bytes) -> Sequence[bytes]:
        edit = by_id.get(_id_of(frame))
        if edit is None:
            return (frame,)
        message = common.MAVLink(None).decode(bytearray(frame))
        out = []
        for each in edit(message):
            mav = common.MAVLink(None, srcSystem=frame[5], srcComponent=frame[6])
            mav.seq = frame[4]
            out.append(bytes(each.pack(mav)))
        return out

    return change


def _with(**fields: Any) -> Edit:
    """The message with other values."""

    def edit(message: Any) -> Sequence[Any]:
        for name, value in fields.items():
            setattr(message, name, value(message) if callable(value) else value)
        return (message,)

    return edit


def _only_if(keep: Callable[[Any], bool]) -> Edit:
    return lambda message: (message,) if keep(message) else ()


@dataclass(frozen=True)
class Mutant:
    """One deviation.

    Attributes:
        name: the deviation in words.
        caught_by: the fact that differs.
        mutate: changes an emulator that is about to be checked.
        profile: another vehicle.
        flies: a flight is needed to see it.
        px4: version that it deviates from.
    """

    name: str
    caught_by: str
    mutate: Callable[[Wires], None] = lambda wires: None
    profile: VehicleProfile = field(default_factory=VehicleProfile)
    flies: bool = False
    px4: str = "1.16"


def _sends(**edits: Edit) -> Callable[[Wires], None]:
    def mutate(wires: Wires) -> None:
        wires.outgoing = editing(**edits)

    return mutate


def _hears(**edits: Edit) -> Callable[[Wires], None]:
    def mutate(wires: Wires) -> None:
        wires.incoming = editing(**edits)

    return mutate


def _secretly(**parameters: float) -> Callable[[Wires], None]:
    def mutate(wires: Wires) -> None:
        wires.emulator.autopilots[0].params.values.update(parameters)

    return mutate


def _one_ack(wires: Wires) -> None:
    is_second = [False]

    def edit(ack: Any) -> Sequence[Any]:
        is_second[0] = ack.command == 176 and not is_second[0]
        return () if is_second[0] else (ack,)

    wires.outgoing = editing(COMMAND_ACK=edit)


def _two_acks(wires: Wires) -> None:
    wires.outgoing = editing(COMMAND_ACK=lambda ack: (ack, ack) if ack.command == 176 else (ack,))


def _without_keys(wires: Wires) -> None:
    wires.incoming = lambda datagram: (
        () if IDS["SETUP_SIGNING"] == _id_of(datagram) else (datagram,)
    )


def _unfiltered(wires: Wires) -> None:
    _secretly(MC_REF_W_N=0.0)(wires)
    wires.emulator.parameters_changed(0)


def _heartbeat_on_change(wires: Wires) -> None:
    newest: list[bytes] = []

    def outgoing(frame: bytes) -> Sequence[bytes]:
        if _id_of(frame) == IDS["HEARTBEAT"]:
            newest[:] = [frame]
        if _id_of(frame) == IDS["COMMAND_ACK"] and newest:
            return (frame, newest[0])
        return (frame,)

    wires.outgoing = outgoing


def _no_return_to_offboard(wires: Wires) -> None:
    state = {"last_s": 0.0, "barred": False}

    def setpoint(message: Any) -> Sequence[Any]:
        now_s = wires.emulator.time_s
        state["barred"] = state["barred"] or (
            wires.emulator.autopilots[0].is_armed and now_s - state["last_s"] > 1.0
        )
        state["last_s"] = now_s
        return () if state["barred"] else (message,)

    def command(message: Any) -> Sequence[Any]:
        state["barred"] = state["barred"] and message.command not in (176, 400)
        return (message,)

    wires.incoming = editing(SET_ATTITUDE_TARGET=setpoint, COMMAND_LONG=command)


def _rate_needed(wires: Wires) -> None:
    last_s = [0.0]

    def setpoint(message: Any) -> Sequence[Any]:
        gap_s = wires.emulator.time_s - last_s[0]
        last_s[0] = wires.emulator.time_s
        return (message,) if gap_s < 0.3 else ()

    wires.incoming = editing(SET_ATTITUDE_TARGET=setpoint)


def _no_lock(wires: Wires) -> None:
    wires.follows_newest = True


def _number_not_bytes(message: Any) -> Sequence[Any]:
    if message.param_type == 6:
        message.param_value = float(struct.unpack("<i", struct.pack("<f", message.param_value))[0])
    return (message,)


def _is_unit(message: Any) -> bool:
    return abs(math.hypot(*message.q) - 1.0) < 0.01


def _limit_tilt(message: Any) -> Sequence[Any]:
    w, x, _, _ = message.q
    if abs(2.0 * math.atan2(x, w)) > math.radians(45.0):
        half = math.copysign(math.radians(22.5), x * w)
        message.q = [math.cos(half), math.sin(half), 0.0, 0.0]
    return (message,)


def _body_velocity(message: Any) -> Sequence[Any]:
    w, x, y, z = message.q
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    north = message.vx
    east = message.vy
    message.vx = math.cos(yaw) * north + math.sin(yaw) * east
    message.vy = -math.sin(yaw) * north + math.cos(yaw) * east
    return (message,)


def _fuse_mocap(message: Any) -> Sequence[Any]:
    fields = {"usec": message.time_usec, "x": message.x, "y": message.y, "z": message.z}
    return (
        common.MAVLink_vision_position_estimate_message(**fields, roll=0.0, pitch=0.0, yaw=0.0),
    )


def _vehicle(**fields: Any) -> VehicleProfile:
    return dataclasses.replace(VehicleProfile(), **fields)


_LOITER = 50593792
_ARMED = 0x80

MUTANTS: tuple[Mutant, ...] = (
    Mutant("one ACK for DO_SET_MODE", "mode.two-acks", _one_ack),
    Mutant("heartbeat on change", "heartbeat.not-on-change", _heartbeat_on_change),
    Mutant("a second sender takes the stream", "link.second-sender", _no_lock),
    Mutant(
        "STATUSTEXT for everybody",
        "text.none-for-companion",
        _hears(HEARTBEAT=_with(type=6)),
    ),
    Mutant(
        "no STATUSTEXT at all",
        "text.backlog",
        _sends(STATUSTEXT=lambda message: ()),
    ),
    Mutant(
        "long texts in one piece",
        "text.chunks",
        _sends(STATUSTEXT=_only_if(lambda message: message.chunk_seq == 0)),
    ),
    Mutant("another default", "param.MPC_THR_HOVER", _secretly(MPC_THR_HOVER=0.45)),
    Mutant("integers as numbers", "param.set-integer", _sends(PARAM_VALUE=_number_not_bytes)),
    Mutant("auto-disarm after 5 s", "arm.auto-disarm", _secretly(COM_DISARM_PRFLT=5.0)),
    Mutant(
        "asked rates are ignored",
        "rate.local-position-100",
        _hears(COMMAND_LONG=_with(param2=lambda m: 0.0 if m.command == 511 else m.param2)),
    ),
    Mutant(
        "unknown commands are accepted",
        "ack.unknown-command",
        _sends(COMMAND_ACK=_with(result=lambda m: 0 if m.result == 3 else m.result)),
    ),
    Mutant(
        "commands for others are taken",
        "ack.wrong-target",
        _hears(COMMAND_LONG=_with(target_system=1)),
    ),
    Mutant(
        "ODOMETRY says body frame",
        "quirk.odometry-frames",
        _sends(ODOMETRY=_with(child_frame_id=12)),
    ),
    Mutant(
        "cell voltages",
        "quirk.battery-voltage",
        _sends(BATTERY_STATUS=_with(voltages=lambda m: [m.voltages[0] // 4] * 4 + [65535] * 6)),
    ),
    Mutant(
        "servo 1000 while disarmed",
        "quirk.servo-disarmed",
        _sends(SERVO_OUTPUT_RAW=_with(servo1_raw=1000)),
    ),
    Mutant(
        "OFFBOARD needs setpoints even disarmed",
        "mode.offboard-disarmed",
        _sends(
            HEARTBEAT=_with(
                custom_mode=lambda m: m.custom_mode if m.base_mode & _ARMED else _LOITER
            )
        ),
    ),
    Mutant(
        "another simulated pace of ATTITUDE",
        "stream.attitude",
        _sends(ATTITUDE=_only_if(lambda m: m.time_boot_ms % 3 > 0)),
    ),
    Mutant(
        "offboard timeout 0.5 s", "loss.action-0-time", _secretly(COM_OF_LOSS_T=0.5), flies=True
    ),
    Mutant(
        "no return to OFFBOARD by itself",
        "loss.action-0-return",
        _no_return_to_offboard,
        flies=True,
    ),
    Mutant(
        "setpoints for others count",
        "loss.wrong-target",
        _hears(SET_ATTITUDE_TARGET=_with(target_system=1)),
        flies=True,
    ),
    Mutant(
        "OFFBOARD again after the blind landing is forgotten",
        "loss.mode-after",
        _sends(
            HEARTBEAT=_with(
                custom_mode=lambda m: m.custom_mode if m.base_mode & _ARMED else _LOITER
            )
        ),
        flies=True,
    ),
    Mutant(
        "NaN thrust refused",
        "setpoint.nan-thrust",
        _hears(SET_ATTITUDE_TARGET=_only_if(lambda message: math.isfinite(message.thrust))),
        flies=True,
    ),
    Mutant(
        "unit quaternions demanded",
        "setpoint.scaled-quaternion",
        _hears(SET_ATTITUDE_TARGET=_only_if(_is_unit)),
        flies=True,
    ),
    Mutant(
        "a tilt limit", "setpoint.steep-50", _hears(SET_ATTITUDE_TARGET=_limit_tilt), flies=True
    ),
    Mutant("two setpoints a second are too few", "offboard.two-hertz", _rate_needed, flies=True),
    Mutant(
        "disarming in the air accepted",
        "offboard.disarm-in-air",
        _hears(
            COMMAND_LONG=_with(
                param2=lambda m: 21196.0 if m.command == 400 and not m.param1 else m.param2
            )
        ),
        flies=True,
    ),
    Mutant(
        "ODOMETRY's velocity along the body",
        "quirk.odometry-velocity",
        _sends(ODOMETRY=_body_velocity),
        flies=True,
    ),
    Mutant(
        "IN_AIR as soon as it leaves the ground",
        "takeoff.state",
        _sends(
            EXTENDED_SYS_STATE=_with(
                landed_state=lambda m: 2 if m.landed_state == 3 else m.landed_state
            )
        ),
        flies=True,
    ),
    Mutant(
        "another hover thrust", "hover.thrust", profile=_vehicle(hover_thrust_frac=0.6), flies=True
    ),
    Mutant("slow tilt", "step.roll-10-t63", profile=_vehicle(attitude_wn_rad_s=8.0), flies=True),
    Mutant(
        "yaw as quick as tilt", "step.yaw-30-t63", profile=_vehicle(yaw_wn_rad_s=6.0), flies=True
    ),
    Mutant(
        "OFFBOARD goes on with an empty battery",
        "battery.hold-mode",
        _secretly(BAT_CRIT_THR=-1.0, BAT_EMERGEN_THR=-1.0),
        flies=True,
    ),
    Mutant("two ACKs for DO_SET_MODE in v1.18", "mode.two-acks", _two_acks, px4="1.18"),
    Mutant("no key by SETUP_SIGNING in v1.18", "signing.messages", _without_keys, px4="1.18"),
    Mutant(
        "no lasting harm by a quaternion of zeros in v1.18",
        "setpoint.zero-quaternion-after",
        _hears(SET_ATTITUDE_TARGET=_only_if(lambda message: any(message.q))),
        flies=True,
        px4="1.18",
    ),
    Mutant(
        "sticks without effect in v1.18",
        "stick.fast",
        _secretly(MAN_OVERRIDE_SPD=-1.0),
        flies=True,
        px4="1.18",
    ),
    Mutant(
        "no filter of setpoints in v1.18", "step.roll-10-t5", _unfiltered, flies=True, px4="1.18"
    ),
    Mutant(
        "ATT_POS_MOCAP is fused",
        "vision.mocap-ignored",
        _hears(ATT_POS_MOCAP=_fuse_mocap),
        flies=True,
    ),
)
