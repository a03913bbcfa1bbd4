"""MAVLink commands (COMMAND_LONG, COMMAND_INT) as a table of numbers and handlers.

The table is at the end of the file. Each handler carries out a command. It returns the result for
the acknowledgement, and messages to send after it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sitl.emulator.emulator import Emulator
from sitl.mavlink.codec import ID_BY_NAME, Encoder, MavlinkMessage
from sitl.mavlink.streams import BUILDERS, Schedule
from sitl.mavlink.view import View
from sitl.px4.commander import EmulatedPx4
from sitl.px4.modes import CommandResult, Mode

_DO_SET_MODE = 176
_REQUEST_MESSAGE = 512
_REQUEST_PROTOCOL_VERSION = 519
# Commands that are also answered when they are sent to all systems, and to any component.
FOR_EVERYBODY = frozenset({_REQUEST_MESSAGE, _REQUEST_PROTOCOL_VERSION})

# Parameters of larger magnitude are ignored.
_MAX_INTEGER = 2**31
_MAX_ALTITUDE_M = 1e5
_MAX_POSITION_M = 1e4  # from the local origin, per axis


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
        """Return one message with its present content; None without content."""

    def ack(self, message: MavlinkMessage, command: int, result: CommandResult) -> bytes:
        """Return the answer to a command."""


@dataclass(frozen=True, slots=True)
class ReceivedCommand:
    """One command, with the parameters of its message."""

    # The seven parameters. Clients send NaN for those that they do not use.
    numbers: tuple[float, ...]
    is_integer: bool  # whether coordinates are degrees times 1e7 (COMMAND_INT)

    def __getitem__(self, index: int) -> float:
        """Return parameter 1 to 7; 0 for NaN and infinity."""
        value = self.numbers[index - 1]
        if not math.isfinite(value):
            return 0.0
        return value

    def integer(self, index: int) -> int:
        """Return parameter 1 to 7 as the nearest whole number; -1 when it is too large."""
        value = self[index]
        if abs(value) >= _MAX_INTEGER:
            return -1
        return round(value)


# Result, and further messages; None where PX4 sends no acknowledgement.
Answer = tuple[CommandResult | None, list[bytes]]
Handler = Callable[[CommandedLink, ReceivedCommand], Answer]


def handle(link: CommandedLink, message: MavlinkMessage) -> list[bytes]:
    """Carry out a command; return its acknowledgements and further messages."""
    number = message.fields["command"]
    handler = COMMANDS.get(number)
    version = link.autopilot.version
    if handler is None or number in version.unsupported_commands:
        return [link.ack(message, number, CommandResult.UNSUPPORTED)]

    result, messages = handler(link, _received(message))
    if result is None:
        return messages
    answers = [link.ack(message, number, result)]
    if number == _DO_SET_MODE and version.mode_acks > 1:
        # The MAVLink receiver of PX4 always accepts at once, then the commander sends the result.
        answers.insert(0, link.ack(message, number, CommandResult.ACCEPTED))
    return answers + messages


def _received(message: MavlinkMessage) -> ReceivedCommand:
    fields = message.fields
    is_integer = message.name == "COMMAND_INT"

    first = (fields["param1"], fields["param2"], fields["param3"], fields["param4"])
    if is_integer:
        last = (float(fields["x"]), float(fields["y"]), fields["z"])
    else:
        last = (fields["param5"], fields["param6"], fields["param7"])
    return ReceivedCommand(numbers=(*first, *last), is_integer=is_integer)


def _place(command: ReceivedCommand) -> tuple[float, float, float]:
    """Return parameters 5 to 7 as latitude and longitude [deg] and altitude above the sea [m]."""
    *_, latitude, longitude, altitude_m = command.numbers
    if command.is_integer:
        return latitude * 1e-7, longitude * 1e-7, altitude_m
    return latitude, longitude, altitude_m


# -- flying ----------------------------------------------------------------------------------------


def _enter(mode: Mode, text: str | None = None) -> Handler:
    """Return the handler of a command that enters a mode, with the key of PX4's text."""

    def handler(link: CommandedLink, command: ReceivedCommand) -> Answer:
        return link.autopilot.request(link.view.now_s, mode, text), []

    return handler


def _take_off(link: CommandedLink, command: ReceivedCommand) -> Answer:
    # The altitude is one above the sea, since PX4 ignores the frame.
    latitude_deg, longitude_deg, altitude_m = _place(command)
    goal = np.full(3, math.nan)
    if math.isfinite(latitude_deg) and math.isfinite(longitude_deg):
        north_m, east_m, _ = link.view.to_local(latitude_deg, longitude_deg, 0.0)
        goal[:2] = north_m, east_m
    if abs(altitude_m) < _MAX_ALTITUDE_M:
        goal[2] = link.view.origin_altitude_m - altitude_m
    return link.autopilot.request_takeoff(link.view.now_s, goal), []


def _arm(link: CommandedLink, command: ReceivedCommand) -> Answer:
    requested = command.integer(1)
    if requested not in (0, 1):
        value = command[1]
        link.autopilot.journal.say(link.view.now_s, "bad arm", value, value=value)
        return CommandResult.UNSUPPORTED, []

    is_arming = requested == 1
    return link.autopilot.request_arm(link.view.now_s, is_arming, magic=command[2]), []


def _set_mode(link: CommandedLink, command: ReceivedCommand) -> Answer:
    result = link.autopilot.request_mode(
        link.view.now_s,
        main=command.integer(2) & 0xFF,
        sub=command.integer(3) & 0xFF,
        base_mode=command.integer(1) & 0xFF,
    )
    return result, []


def _terminate(link: CommandedLink, command: ReceivedCommand) -> Answer:
    is_termination = command[1] > 0.5
    if not is_termination:
        return CommandResult.DENIED, []
    return link.autopilot.request_termination(link.view.now_s), []


def _reposition(link: CommandedLink, command: ReceivedCommand) -> Answer:
    """Enter Hold, and let Hold fly to the position in the command, at its heading and speed."""
    changes_mode = command.integer(2) == 1
    if not changes_mode:
        return CommandResult.UNSUPPORTED, []

    result = link.autopilot.request(link.view.now_s, Mode.LOITER)
    if result is not CommandResult.ACCEPTED:
        return result, []

    _, _, _, yaw_rad, *_ = command.numbers
    latitude_deg, longitude_deg, altitude_m = _place(command)
    if math.isinf(latitude_deg) or math.isinf(longitude_deg):
        latitude_deg = math.nan  # treat it as missing, because an infinite angle has no cosine
        longitude_deg = math.nan
    position = np.array(link.view.to_local(latitude_deg, longitude_deg, altitude_m))

    # A coordinate that is too far away counts as missing. Without a height the vehicle stays at its
    # present height. With a height or a heading alone it keeps its goal. Without anything it stops.
    is_usable = np.abs(position) < _MAX_POSITION_M
    position[~is_usable] = math.nan
    present = np.array(link.emulator.estimator.local(link.index).position_ned_m)
    if not is_usable.any() and not math.isfinite(yaw_rad):
        position = present
    elif not is_usable[2]:
        position[2] = present[2]

    if not link.autopilot.fence_allows(position):
        link.autopilot.journal.say(link.view.now_s, "goal beyond fence")
        return result, []

    control = link.autopilot.mode_control
    control.hold_at(position, yaw_rad)
    # Without a speed above zero, a speed that was commanded in this Hold goes on.
    if command[1] > 0.0:
        control.cruise_m_s = command[1]
    return result, []


def _change_speed(link: CommandedLink, command: ReceivedCommand) -> Answer:
    # The speed applies until the mode ends. Without a speed above zero the parameter applies again.
    speed_m_s: float | None = command[2]
    if command[2] <= 0.0:
        speed_m_s = None
    link.autopilot.mode_control.cruise_m_s = speed_m_s
    return CommandResult.ACCEPTED, []


def _set_home(link: CommandedLink, command: ReceivedCommand) -> Answer:
    is_here = command[1] > 0.5
    latitude_deg, longitude_deg, altitude_m = _place(command)
    is_on_earth = (
        abs(latitude_deg) <= 90.0
        and abs(longitude_deg) <= 180.0
        and abs(altitude_m) < _MAX_ALTITUDE_M
    )
    if not is_here and not is_on_earth:
        return CommandResult.DENIED, []
    if not link.view.has_origin:
        return CommandResult.TEMPORARILY_REJECTED, []

    if is_here:
        position = link.emulator.estimator.local(link.index).position_ned_m
    else:
        position = link.view.to_local(latitude_deg, longitude_deg, altitude_m)
    control = link.autopilot.mode_control
    control.home_ned_m = np.array(position, dtype=float)
    control.is_home_commanded = not is_here
    return CommandResult.ACCEPTED, []


def _start_mission(link: CommandedLink, command: ReceivedCommand) -> Answer:
    return CommandResult.DENIED, []  # missions are not emulated


# -- further commands ------------------------------------------------------------------------------


def _accept(link: CommandedLink, command: ReceivedCommand) -> Answer:
    return CommandResult.ACCEPTED, []


def _store(link: CommandedLink, command: ReceivedCommand) -> Answer:
    # Parameters stay until the end of the emulator, so nothing is loaded (0) or saved (1), and
    # sensors have no calibration to reset (3).
    resets = (2, 4)
    unchanged = (0, 1, 3)
    if link.autopilot.is_armed:
        return CommandResult.TEMPORARILY_REJECTED, []

    requested = int(command[1])
    if requested in resets:
        link.emulator.reset_parameters(link.index)
    elif requested not in unchanged:
        return None, []
    return CommandResult.ACCEPTED, []


def _reboot(link: CommandedLink, command: ReceivedCommand) -> Answer:
    no_action = 0
    reboot = 1
    requested = command.integer(1)
    if requested == no_action:
        return CommandResult.ACCEPTED, []
    if requested != reboot or link.autopilot.is_armed:
        return CommandResult.DENIED, []

    link.emulator.reboot(link.index)
    return CommandResult.ACCEPTED, []


def _set_interval(link: CommandedLink, command: ReceivedCommand) -> Answer:
    is_set = link.schedule.set_interval(command.integer(1), command[2], link.view.now_s)
    if not is_set:
        return CommandResult.FAILED, []
    return CommandResult.ACCEPTED, []


def _get_interval(link: CommandedLink, command: ReceivedCommand) -> Answer:
    message_id = command.integer(1) & 0xFFFF
    interval_us = link.schedule.interval_us(message_id)
    answer = link.encoder.encode_named(
        "MESSAGE_INTERVAL", message_id=message_id, interval_us=interval_us
    )
    return CommandResult.ACCEPTED, [answer]


def _request_message(link: CommandedLink, command: ReceivedCommand) -> Answer:
    message_id = command.integer(1)
    if message_id not in BUILDERS:
        return CommandResult.DENIED, []

    message = link.build(message_id)
    if message is None:
        return CommandResult.DENIED, []
    return CommandResult.ACCEPTED, [message]


def _request(name: str) -> Handler:
    """Return the handler of a command that requests one message and is always accepted."""

    def handler(link: CommandedLink, command: ReceivedCommand) -> Answer:
        message = link.build(ID_BY_NAME[name])
        if message is None:
            return CommandResult.ACCEPTED, []
        return CommandResult.ACCEPTED, [message]

    return handler


COMMANDS: dict[int, Handler] = {
    20: _enter(Mode.RTL, "returning"),  # NAV_RETURN_TO_LAUNCH
    21: _enter(Mode.LAND),  # NAV_LAND
    22: _take_off,  # NAV_TAKEOFF
    _DO_SET_MODE: _set_mode,
    178: _change_speed,  # DO_CHANGE_SPEED
    179: _set_home,  # DO_SET_HOME
    185: _terminate,  # DO_FLIGHTTERMINATION
    189: _accept,  # DO_LAND_START: the landing of a mission, which does nothing without a mission
    192: _reposition,  # DO_REPOSITION
    245: _store,  # PREFLIGHT_STORAGE
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
