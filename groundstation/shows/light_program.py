"""Skybrush's light programs: bytes of commands -> the times at which colours are set. Pure."""

from __future__ import annotations

from groundstation.paths.lights import Light

_FRAME_S = 0.02  # durations are frames of 50 a second
_MOST = 100_000  # commands, with those of loops
_END, _SLEEP, _WAIT, _LOOP, _LOOP_END = 0, 2, 3, 12, 13
_SET, _FADE = range(4, 8), range(8, 12)  # colour, grey, black, white
_PYRO = (20, 21)


def colours(data: bytes) -> tuple[Light, ...]:
    """Return the colours of a program; between two of them the colour changes evenly.

    Args:
        data: its bytes.

    Raises:
        ValueError: a command is not known, the bytes end within one, or loops do not end.
    """
    reader = _Reader(data)
    out: list[Light] = [(0.0, 0, 0, 0)]
    loops: list[list[int]] = []  # where it begins, how often it still runs
    now_s = 0.0
    for _ in range(_MOST):
        command = reader.byte() if reader.has_more else _END
        last = out[-1][1:]
        if command == _END:
            return tuple(out)
        if command in _SET or command in _FADE:
            colour = _colour(reader, command % 4)
            out.append((now_s, *(colour if command in _SET else last)))
            now_s += reader.frames() * _FRAME_S
            out.append((now_s, *colour))
        elif command == _SLEEP:
            now_s += reader.frames() * _FRAME_S
            out.append((now_s, *last))
        elif command == _WAIT:
            now_s = max(now_s, reader.frames() * _FRAME_S)
            out.append((now_s, *last))
        elif command == _LOOP:
            loops.append([0, reader.byte()])
            loops[-1][0] = reader.at
        elif command == _LOOP_END:
            if not loops:
                raise ValueError("a loop ends that has not begun")
            loops[-1][1] -= 1
            if loops[-1][1] == 0:
                loops.pop()
            else:
                reader.at = loops[-1][0]
        elif command in _PYRO:
            reader.byte()
        elif command != 1:
            raise ValueError(f"its command {command} is not known")
    raise ValueError("it has no end")


class _Reader:
    """The bytes of a program, one after the other."""

    def __init__(self, data: bytes) -> None:
        self._data, self.at = data, 0

    @property
    def has_more(self) -> bool:
        """Whether bytes are left."""
        return self.at < len(self._data)

    def byte(self) -> int:
        """Return the next byte."""
        if not self.has_more:
            raise ValueError("it ends within a command")
        self.at += 1
        return self._data[self.at - 1]

    def frames(self) -> int:
        """Return a duration: seven bits in each byte, the lowest first."""
        value, shift = 0, 0
        while True:
            byte = self.byte()
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128 or shift > 35:
                return value


def _colour(reader: _Reader, kind: int) -> tuple[int, int, int]:
    """Return the colour of a command: 0 in full, 1 grey, 2 black, 3 white."""
    if kind == 0:
        return reader.byte(), reader.byte(), reader.byte()
    grey = reader.byte() if kind == 1 else 0 if kind == 2 else 255
    return grey, grey, grey
