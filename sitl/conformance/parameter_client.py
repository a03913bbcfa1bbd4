"""Reading, setting and restoring of the parameters of one vehicle."""

from __future__ import annotations

import struct
from typing import Any, Protocol

from pymavlink.dialects.v20 import common

from sitl.conformance.endpoint import ReceivedPacket, Recording, VehicleClock

# Struct of each MAV_PARAM_TYPE that is a whole number.
_INTEGER_STRUCTS = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}
_ATTEMPTS = 3
# Longest wait for an answer. The longer of the two applies, because a simulator can be faster than
# its link.
_ANSWER_S = 0.5  # by the vehicle's clock
_ANSWER_REAL_S = 0.3  # by this computer's clock
_MAV_PARAM_TYPE_REAL32 = 9
_PARAM_VALUE = int(common.MAVLink_param_value_message.id)


class Messenger(Protocol):
    """The parts of a vehicle's client that parameters need."""

    system_id: int
    clock: VehicleClock
    received: Recording

    def send(self, name: str, **fields: Any) -> None:
        """Send one message."""

    def wait(self, duration_s: float, until: Any = None) -> bool:
        """Wait for a time, or until a condition holds."""


class ParameterClient:
    """Client for the parameters of one vehicle, which can restore all changed values."""

    def __init__(self, client: Messenger) -> None:
        self._client = client
        # Value and type of each changed parameter before its first change. A parameter is removed
        # when the vehicle has confirmed that it has its original value again.
        self._originals: dict[str, tuple[float, int]] = {}

    def read(self, name: str) -> float | None:
        """Return the value of a parameter; None if the vehicle does not answer."""
        answer = self._read(name)
        if answer is None:
            return None
        value, _ = answer
        return value

    def set(self, name: str, value: float) -> float | None:
        """Set a parameter and store its original value.

        Return the value that the vehicle answers; None if it does not answer.
        """
        before = self._read(name)
        if before is None:
            return None

        self._originals.setdefault(name, before)
        _, kind = before
        return self._write(name, value, kind)

    def restore(self) -> None:
        """Restore the original values of all changed parameters, the last change first.

        A parameter that the vehicle does not confirm stays in :attr:`changed`.
        """
        for name, (value, kind) in reversed([*self._originals.items()]):
            if self._write(name, value, kind) == value:
                del self._originals[name]

    @property
    def changed(self) -> dict[str, float]:
        """Original values of the parameters that are not restored."""
        return {name: value for name, (value, _) in self._originals.items()}

    def _read(self, name: str) -> tuple[float, int] | None:
        for _ in range(_ATTEMPTS):
            count_before = len(self._values)
            self._client.send(
                "PARAM_REQUEST_READ",
                target_system=self._client.system_id,
                target_component=1,
                param_id=name.encode("ascii"),
                param_index=-1,
            )
            answer = self._answer(name, count_before)
            if answer is not None:
                return answer
        return None

    def _write(self, name: str, value: float, kind: int) -> float | None:
        """Send a value until the vehicle answers with it; return the last value that it answers."""
        if kind == _MAV_PARAM_TYPE_REAL32:
            packed = struct.pack("<f", value)
        else:
            # the bytes of the whole number, put into the field of a float
            packed = struct.pack(_INTEGER_STRUCTS[kind], int(value)).ljust(4, b"\0")
        (encoded,) = struct.unpack("<f", packed)

        answered_value = None
        for _ in range(_ATTEMPTS):
            count_before = len(self._values)
            self._client.send(
                "PARAM_SET",
                target_system=self._client.system_id,
                target_component=1,
                param_id=name.encode("ascii"),
                param_value=encoded,
                param_type=kind,
            )
            answer = self._answer(name, count_before)
            if answer is None:
                continue
            answered_value, _ = answer
            if answered_value == _decoded(encoded, kind):
                break
        return answered_value

    @property
    def _values(self) -> list[ReceivedPacket]:
        """All values of parameters that have arrived, the newest last."""
        return self._client.received.packets[_PARAM_VALUE]

    def _answer(self, name: str, count_before: int) -> tuple[float, int] | None:
        """Wait for the value of a parameter; return it with its type, or None without an answer.

        Args:
            name: name of the parameter.
            count_before: number of values that had arrived before the request.
        """
        answers: list[tuple[float, int]] = []

        def is_answered() -> bool:
            for packet in self._values[count_before:]:
                if packet.message.param_id == name:
                    answers.append(parameter_value(packet.message))
                    return True
            return False

        wait_s = max(_ANSWER_S, _ANSWER_REAL_S * self._client.clock.pace)
        self._client.wait(wait_s, is_answered)
        if not answers:
            return None
        return answers[0]


def parameter_value(message: Any) -> tuple[float, int]:
    """Return value and type of a PARAM_VALUE."""
    kind = int(message.param_type)
    return _decoded(message.param_value, kind), kind


def _decoded(field: float, kind: int) -> float:
    """Return the value of a parameter from the float field of a message.

    For an integer parameter the field holds the bytes of the integer.
    """
    if kind not in _INTEGER_STRUCTS:
        return float(field)

    layout = struct.Struct(_INTEGER_STRUCTS[kind])
    (value,) = layout.unpack(struct.pack("<f", field)[: layout.size])
    return float(value)
