"""MAVLink commands (COMMAND_LONG, COMMAND_INT) as a table: number, what is done, and the answer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sitl.emulator.emulator import Emulator
from sitl.mavlink.codec import ID_BY_NAME, Encoder, MavlinkMessage
from sitl.mavlink.streams import BUILDERS, Schedule
from sitl.mavlink.view import HOME_ALTITUDE_M, View
from sitl.px4.commander import EmulatedPx4
from sitl.px4.modes import CommandResult, Mode

_DO_SET_MODE = 176
_REQUEST_MESSAGE, _REQUEST_PROTOCOL_VERSION = 512, 519
# Answered also when they are sent to everybody, and to any component.
FOR_EVERYBODY = frozenset({_REQUEST_MESSAGE, _REQUEST_PROTOCOL_VERSION})
_LARGEST = 2**31
_HIGHEST_M = 1e5


class CommandedLink(Protocol):
    """The parts of a link that commands read and change."""

    emulator: Emulator
    index: int
    view: View
    encoder: Encoder
    schedule: Schedule

    @property
    def autopilot(self) -> EmulatedPx4:
        """The autopilot behind the link."""

    def build(self, message_id: int) -> bytes | None:
        """Return one message with its present contents; None: it has none."""

    def ack(self, message: MavlinkMessage, command: int, result: CommandResult) -> bytes:
        """Return the answer to a command."""


@dataclass(frozen=True, slots=True)
class ReceivedCommand:
    """One command as it arrived."""

    # the seven parameters; NaN, which clients send for what they do not use, is kept
    numbers: tuple[float, ...]
    is_integer: bool  # whether places are degrees times 1e7 (COMMAND_INT)

    def __getitem__(self, index: int) -> float:
        """Parameter 1 to 7; 0 for NaN and infinity."""
        value = self.numbers[index - 1]
        return value if math.isfinite(value) else 0.0

    def integer(self, index: int) -> int:
        """Parameter 1 to 7 as the nearest whole number, -1 when it is too large to be one."""
        value = self[index]
        return round(value) if abs(value) < _LARGEST else -1


Answer = tuple[CommandResult, list[bytes]]
Handler = Callable[[CommandedLink, ReceivedCommand], Answer]


def handle(link: CommandedLink, message: MavlinkMessage) -> list[bytes]:
    """Everything that is sent back for a command."""
    f = message.fields
    number = f["command"]
    is_integer = message.name == "COMMAND_INT"
    last = (
        (float(f["x"]), float(f["y"]), f["z"])
        if is_integer
        else (f["param5"], f["param6"], f["param7"])
    )
    command = ReceivedCommand(
        (f["param1"], f["param2"], f["param3"], f["param4"], *last), is_integer
    )
    handler = _COMMANDS.get(number)
    version = link.autopilot.version
    if handler is None or number in version.unsupported_commands:
        return [link.ack(message, number, CommandResult.UNSUPPORTED)]
    result, extra = handler(link, command)
    answers = [link.ack(message, number, result)]
    if number == _DO_SET_MODE and version.mode_acks > 1:
        # Its receiver answers at once and always yes, then its commander with the truth.
        answers.insert(0, link.ack(message, number, CommandResult.ACCEPTED))
    return answers + extra


def _enter(mode: Mode, said: str | None = None) -> Handler:
    def handler(link: CommandedLink, command: ReceivedCommand) -> Answer:
        return link.autopilot.request(link.view.now_s, mode, said), []

    return handler


def _accept(link: CommandedLink, command: ReceivedCommand) -> Answer:
    return CommandResult.ACCEPTED, []


def _take_off(link: CommandedLink, command: ReceivedCommand) -> Answer:
    above_sea_m = command.numbers[6]  # as PX4 takes it, whatever the frame
    height_m = above_sea_m - HOME_ALTITUDE_M if abs(above_sea_m) < _HIGHEST_M else math.nan
    return link.autopilot.request_takeoff(link.view.now_s, height_m), []


def _arm(link: CommandedLink, command: ReceivedCommand) -> Answer:
    wanted = command.integer(1)
    if wanted not in (0, 1):
        value = command[1]
        link.autopilot.journal.say(link.view.now_s, "bad arm", value, value=value)
        return CommandResult.UNSUPPORTED, []
    return link.autopilot.request_arm(link.view.now_s, wanted == 1, command[2]), []


def _set_mode(link: CommandedLink, command: ReceivedCommand) -> Answer:
    base, main, sub = (
        command.integer(1) & 0xFF,
        command.integer(2) & 0xFF,
        command.integer(3) & 0xFF,
    )
    return link.autopilot.request_mode(link.view.now_s, main, sub, base), []


def _terminate(link: CommandedLink, command: ReceivedCommand) -> Answer:
    if command[1] <= 0.5:
        return CommandResult.DENIED, []
    return link.autopilot.request_termination(link.view.now_s), []


def _reposition(link: CommandedLink, command: ReceivedCommand) -> Answer:
    if command.integer(2) != 1:
        return CommandResult.UNSUPPORTED, []
    result = link.autopilot.request(link.view.now_s, Mode.LOITER)
    if result is CommandResult.ACCEPTED:
        scale = 1e-7 if command.is_integer else 1.0
        latitude, longitude, altitude_m = (
            command.numbers[i] * s for i, s in ((4, scale), (5, scale), (6, 1.0))
        )
        position = np.array(link.view.to_local(latitude, longitude, altitude_m))
        # No coordinate, or one that is on another continent: stay.
        link.autopilot.mode_control.hold_at(np.where(np.abs(position) < 1e4, position, math.nan))
    return result, []


def _change_speed(link: CommandedLink, command: ReceivedCommand) -> Answer:
    speed_m_s = command[2]
    if speed_m_s > 0.0:
        limit = link.autopilot.params["MPC_XY_VEL_MAX"]
        link.autopilot.params.values["MPC_XY_CRUISE"] = min(speed_m_s, limit)
    return CommandResult.ACCEPTED, []


def _set_home(link: CommandedLink, command: ReceivedCommand) -> Answer:
    # Home is where the vehicle was armed; only "here" can be said, as ground stations do.
    if command[1] <= 0.5:
        return CommandResult.DENIED, []
    return (
        CommandResult.ACCEPTED if link.view.has_origin else CommandResult.TEMPORARILY_REJECTED
    ), []


def _start_mission(link: CommandedLink, command: ReceivedCommand) -> Answer:
    return CommandResult.DENIED, []  # there is none


def _store(link: CommandedLink, command: ReceivedCommand) -> Answer:
    return (
        CommandResult.TEMPORARILY_REJECTED if link.autopilot.is_armed else CommandResult.ACCEPTED
    ), []


def _reboot(link: CommandedLink, command: ReceivedCommand) -> Answer:
    wanted = command.integer(1)
    if wanted == 0:
        return CommandResult.ACCEPTED, []
    if wanted != 1 or link.autopilot.is_armed:
        return CommandResult.DENIED, []
    link.emulator.reboot(link.index)
    return CommandResult.ACCEPTED, []


def _set_interval(link: CommandedLink, command: ReceivedCommand) -> Answer:
    done = link.schedule.set_interval(command.integer(1), command[2], link.view.now_s)
    return (CommandResult.ACCEPTED if done else CommandResult.FAILED), []


def _get_interval(link: CommandedLink, command: ReceivedCommand) -> Answer:
    wanted = command.integer(1) & 0xFFFF
    interval_us = link.schedule.interval_us(wanted)
    return CommandResult.ACCEPTED, [
        link.encoder.encode_named("MESSAGE_INTERVAL", message_id=wanted, interval_us=interval_us)
    ]


def _send(link: CommandedLink, message_id: int) -> Answer:
    answer = link.build(message_id)
    return (CommandResult.DENIED, []) if answer is None else (CommandResult.ACCEPTED, [answer])


def _request_message(link: CommandedLink, command: ReceivedCommand) -> Answer:
    wanted = command.integer(1)
    return _send(link, wanted) if wanted in BUILDERS else (CommandResult.DENIED, [])


def _request(name: str) -> Handler:
    def handler(link: CommandedLink, command: ReceivedCommand) -> Answer:
        _, answer = _send(link, ID_BY_NAME[name])
        return CommandResult.ACCEPTED, answer

    return handler


_COMMANDS: dict[int, Handler] = {
    20: _enter(Mode.RTL, "returning"),  # NAV_RETURN_TO_LAUNCH
    21: _enter(Mode.LAND),  # NAV_LAND
    22: _take_off,  # NAV_TAKEOFF
    _DO_SET_MODE: _set_mode,
    178: _change_speed,  # DO_CHANGE_SPEED
    179: _set_home,  # DO_SET_HOME
    185: _terminate,  # DO_FLIGHTTERMINATION
    189: _accept,  # DO_LAND_START: the landing part of a mission; without one nothing happens
    192: _reposition,  # DO_REPOSITION
    245: _store,  # PREFLIGHT_STORAGE: parameters are kept for the run
    246: _reboot,  # PREFLIGHT_REBOOT_SHUTDOWN
    300: _start_mission,  # MISSION_START
    400: _arm,  # COMPONENT_ARM_DISARM
    410: _request("HOME_POSITION"),  # GET_HOME_POSITION
    510: _get_interval,  # GET_MESSAGE_INTERVAL
    511: _set_interval,  # SET_MESSAGE_INTERVAL
    _REQUEST_MESSAGE: _request_message,
    _REQUEST_PROTOCOL_VERSION: _request("PROTOCOL_VERSION"),
    520: _request("AUTOPILOT_VERSION"),  # REQUEST_AUTOPILOT_CAPABILITIES
    528: _request("FLIGHT_INFORMATION"),  # REQUEST_FLIGHT_INFORMATION
}
