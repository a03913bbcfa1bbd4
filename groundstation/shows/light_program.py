"""Decodes Skybrush's light programs: bytes of commands become colours at times. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from groundstation.paths.lights import TimedColour

_FRAME_S = 0.02  # a frame, the unit of durations: 50 in a second
# most executed commands, including repetitions: of any program, and more for each second of it
_MAX_COMMANDS = 20_000
_MAX_COMMANDS_1_S = 3.0 / _FRAME_S  # three in each frame

# commands
_END = 0
_NOTHING = 1
_SLEEP = 2
_WAIT = 3
_SET = range(4, 8)  # set to a colour, to grey, to black, to white
_FADE = range(8, 12)  # fade to a colour, to grey, to black, to white
_LOOP = 12
_LOOP_END = 13
_PYRO = (20, 21)


def colours(data: bytes, end_s: float) -> tuple[TimedColour, ...]:
    """Return the colours of a program; between two of them the colour changes linearly.

    Args:
        data: bytes of the program.
        end_s: time of the program at which an endless loop ends [s], one of 0 repetitions.

    Raises:
        ValueError: a command is unknown or incomplete, or there are too many of them.
    """
    reader = _Reader(data)
    lights: list[TimedColour] = [(0.0, 0, 0, 0)]
    loops: list[_Loop] = []
    now_s = 0.0

    most = _MAX_COMMANDS + int(_MAX_COMMANDS_1_S * end_s)
    for _ in range(most):
        command = reader.byte() if reader.has_more else _END
        last_colour = lights[-1][1:]

        if command == _END:
            return tuple(lights)

        if command in _SET or command in _FADE:
            kind = command % 4  # each of the two ranges begins at a multiple of four
            colour = _colour(reader, kind)
            first_colour = colour if command in _SET else last_colour
            lights.append((now_s, *first_colour))
            now_s += reader.frames() * _FRAME_S
            lights.append((now_s, *colour))

        elif command == _SLEEP:
            now_s += reader.frames() * _FRAME_S
            lights.append((now_s, *last_colour))

        elif command == _WAIT:
            now_s = max(now_s, reader.frames() * _FRAME_S)
            lights.append((now_s, *last_colour))

        elif command == _LOOP:
            count = reader.byte()
            loops.append(_Loop(begin=reader.position, left=count, since_s=now_s))

        elif command == _LOOP_END:
            if not loops:
                raise ValueError("a loop ends that has not begun")
            loops[-1].left -= 1
            is_endless = loops[-1].left < 0
            takes_no_time = now_s == loops[-1].since_s
            if is_endless and (now_s >= end_s or takes_no_time):
                return tuple(lights)
            if loops[-1].left == 0:
                loops.pop()
            else:
                reader.position = loops[-1].begin
                loops[-1].since_s = now_s

        elif command in _PYRO:
            reader.byte()

        elif command != _NOTHING:
            raise ValueError(f"its command {command} is not known")

    raise ValueError(f"it has more than {most} commands")


@dataclass(slots=True)
class _Loop:
    """A loop under way."""

    begin: int  # position of its first command
    left: int  # number of remaining repetitions, including this one; below 1 in an endless loop
    since_s: float  # time of the program at which this repetition began [s]


class _Reader:
    """The bytes of a program, one after the other."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.position = 0  # index of the next byte

    @property
    def has_more(self) -> bool:
        """Whether bytes are left."""
        return self.position < len(self._data)

    def byte(self) -> int:
        """Return the next byte."""
        if not self.has_more:
            raise ValueError("it ends within a command")
        self.position += 1
        return self._data[self.position - 1]

    def frames(self) -> int:
        """Return a duration in frames: seven bits in each byte, the lowest bits first."""
        value = 0
        shift = 0
        while True:
            byte = self.byte()
            value |= (byte & 127) << shift
            shift += 7
            # a longer number is not a duration of a show
            if byte < 128 or shift > 35:
                return value


def _colour(reader: _Reader, kind: int) -> tuple[int, int, int]:
    """Return the colour of a command, whose kind is 0 any colour, 1 grey, 2 black, 3 white."""
    if kind == 0:
        return reader.byte(), reader.byte(), reader.byte()

    if kind == 1:
        grey = reader.byte()
    elif kind == 2:
        grey = 0
    else:
        grey = 255
    return grey, grey, grey
