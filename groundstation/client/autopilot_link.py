"""A link to PX4 itself, for commands such as ``covey px4``: parameters, version, signing. Blocking.

A parameter that is sent may be refused, unknown or lost with the link. PX4 v1.16 is silent in all
three cases. So each parameter is read back, and a heartbeat shows whether the link still works.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterable
from typing import Any

from groundstation.client.mavlink_port import (
    ARMED_FLAG,
    AUTOPILOT,
    Signing,
    is_of_autopilot,
    keep_link,
    open_as_companion,
    send_heartbeat,
    send_to_autopilot,
    sign,
    take_link,
)
from onboard.security.mavlink_key import KEY_BYTES, TOOL_LINK_ID, signing_time

Value = float | int

# MAV_CMD
_REQUEST_MESSAGE = 512
_PREFLIGHT_STORAGE = 245  # stores the parameters

_AUTOPILOT_VERSION = 148  # number of the message

# MAV_PARAM_TYPE
_PARAM_INT32 = 6
_PARAM_REAL32 = 9

_ANSWER_S = 0.4  # longest wait for the answer to one request
_VERSION_ATTEMPTS = 3
_ATTEMPTS = 4
_LIST_SILENT_S = 1.5  # silence within a list of parameters, after which missing ones are requested
_LIST_S = 60.0  # longest time for a whole list
_MAX_AT_ONCE = 20  # missing parameters that are requested at once
_HEARTBEAT_S = 2.5


class LinkSilentError(RuntimeError):
    """PX4 is no longer heard."""


class AutopilotLink:
    """One link to one PX4.

    Args:
        endpoint: endpoint of the fleet file.
        system_id: PX4's MAVLink system id.
        is_own: whether this is the vehicle's own link, which is used as the agent would use it;
            otherwise it is PX4's ground link.
        key: key of MAVLink signing; None for a vehicle that does not sign.

    Raises:
        OSError: the endpoint cannot be opened.
        ValueError: the endpoint is not well-formed.
    """

    def __init__(
        self, endpoint: str, system_id: int, *, is_own: bool = False, key: bytes | None = None
    ) -> None:
        self.endpoint = endpoint
        self.system_id = system_id
        self.is_own = is_own
        self.other_system_id: int | None = None  # id of another autopilot that was heard instead
        self._kinds: dict[str, int] = {}  # MAV_PARAM_TYPE of each parameter that was heard

        if is_own:
            self._link = open_as_companion(endpoint, system_id, key)
        else:
            self._link = take_link(endpoint, key)

    def stop(self) -> None:
        """Close the vehicle's own link, or keep a ground link open for the next command."""
        if self.is_own:
            self._link.close()
        else:
            keep_link(self.endpoint, self._link)

    def is_armed(self, timeout_s: float = _HEARTBEAT_S) -> bool | None:
        """Wait for PX4's next heartbeat.

        Args:
            timeout_s: longest wait [s].

        Returns:
            Whether PX4 is armed; None if no heartbeat came.
        """
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            send_heartbeat(self._link)
            message = self._link.recv_match(type="HEARTBEAT", blocking=True, timeout=0.5)
            if message is None or message.get_srcComponent() != AUTOPILOT:
                continue
            if message.get_srcSystem() == self.system_id:
                return bool(message.base_mode & ARMED_FLAG)
            self.other_system_id = message.get_srcSystem()
        return None

    def version(self, timeout_s: float = 1.0) -> tuple[int, int] | None:
        """Request PX4's version.

        Args:
            timeout_s: longest wait for each of three answers [s].

        Returns:
            Major and minor number; None if PX4 does not answer or does not know its version.
        """
        message = None
        for _ in range(_VERSION_ATTEMPTS):  # an answer may be lost on the way
            heard = self.listen(timeout_s, [_AUTOPILOT_VERSION], until="AUTOPILOT_VERSION")
            message = heard.get("AUTOPILOT_VERSION")
            if message is not None:
                break
        if message is None or not message.flight_sw_version:
            return None

        # its four bytes are major, minor, patch, and the kind of firmware
        major, minor, _, _ = message.flight_sw_version.to_bytes(4, "big")
        return (major, minor)

    def sign(self, key: bytes | None) -> Signing:
        """Sign with a key from now on, and also accept messages that are not signed with it.

        The counts show how PX4 signs.

        Args:
            key: key to sign with; None: send unsigned messages.

        Returns:
            Counts of the messages that are received from now on.
        """
        signing = Signing(key, TOOL_LINK_ID, hears_all=True)
        sign(self._link, signing)
        return signing

    def set_key(self, key: bytes | None) -> None:
        """Send a new key to PX4, or none, with SETUP_SIGNING.

        Args:
            key: the new key; None: PX4 forgets its key and stops signing.
        """
        stamp = 0
        sent_key = bytes(KEY_BYTES)  # zeros stand for no key
        if key is not None:
            stamp = signing_time(time.time_ns())
            sent_key = key
        self._link.mav.setup_signing_send(self.system_id, AUTOPILOT, list(sent_key), stamp)

    def listen(
        self,
        seconds: float,
        requested: Iterable[int] = (),
        *,
        until: str = "",
        take: Callable[[Any], object] = lambda message: None,
    ) -> dict[str, Any]:
        """Return the newest message of each kind that PX4 sends.

        Args:
            seconds: longest time to listen [s].
            requested: numbers of messages to request first.
            until: name of a message that ends the listening; empty: none does.
            take: function for every message of this vehicle, including its other components.
        """
        for number in requested:
            self.command(_REQUEST_MESSAGE, float(number))

        heard: dict[str, Any] = {}
        end_s = time.monotonic() + seconds
        while until not in heard:
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                break

            message = self._link.recv_match(blocking=True, timeout=min(left_s, 0.2))
            if message is None or message.get_srcSystem() != self.system_id:
                continue
            take(message)
            if message.get_srcComponent() == AUTOPILOT:
                heard[message.get_type()] = message
        return heard

    def send(self, name: str, *values: object) -> None:
        """Send a message that is addressed to the autopilot.

        Args:
            name: name of the message, in small letters.
            values: values of its fields, without target system and component.
        """
        send_to_autopilot(self._link.mav, self.system_id, name, values)

    def next_message(self, names: Iterable[str], timeout_s: float) -> Any | None:
        """Return the autopilot's next message of one of these names; None if none comes in time."""
        end_s = time.monotonic() + timeout_s
        while True:
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return None
            message = self._link.recv_match(type=list(names), blocking=True, timeout=left_s)
            if message is not None and is_of_autopilot(message, self.system_id):
                return message

    def says_armed(self, heartbeat: Any) -> bool:
        """Return whether a heartbeat says that the vehicle is armed."""
        return bool(heartbeat.base_mode & ARMED_FLAG)

    # -- parameters --------------------------------------------------------------------------------

    def read(self, name: str) -> Value | None:
        """Read a parameter.

        Args:
            name: name of the parameter.

        Returns:
            PX4's value; None if PX4 does not know the parameter.

        Raises:
            LinkSilentError: PX4 is no longer heard.
        """
        return self._value_after(name, lambda: self._request(name))

    def read_params(self, names: Iterable[str]) -> dict[str, Value | None]:
        """Read several parameters, each as :meth:`read` does; return name -> value or None."""
        return {name: self.read(name) for name in names}

    def read_all(self) -> dict[str, Value]:
        """Read every parameter.

        Returns:
            Name -> value.

        Raises:
            LinkSilentError: PX4 is no longer heard, or does not send them all.
        """
        values: dict[int, tuple[str, Value]] = {}  # index -> name and value
        count = 0  # number of PX4's parameters; 0 until PX4 has sent it
        self._link.mav.param_request_list_send(self.system_id, AUTOPILOT)

        end_s = time.monotonic() + _LIST_S
        while time.monotonic() < end_s:
            if count and len(values) == count:
                break

            reply = self._next_value(_LIST_SILENT_S)
            if reply is None:
                if self.is_armed() is None:
                    break
                self._request_missing([index for index in range(count) if index not in values])
            elif reply.param_index < reply.param_count:
                # The hash of all parameters, and an answer by name, have an index beyond the count.
                count = reply.param_count
                values[reply.param_index] = (reply.param_id, self._value(reply))

        if not count:
            raise LinkSilentError("PX4 sent none of its parameters.")
        if len(values) < count:
            raise LinkSilentError(f"PX4 sent {len(values)} of {count} parameters.")
        return dict(values.values())

    def _request_missing(self, indices: list[int]) -> None:
        """Request the missing parameters of a list, or the whole list if nothing has come."""
        if not indices:
            self._link.mav.param_request_list_send(self.system_id, AUTOPILOT)
        for index in indices[:_MAX_AT_ONCE]:
            self._link.mav.param_request_read_send(self.system_id, AUTOPILOT, b"", index)

    def write(self, name: str, value: Value) -> Value | None:
        """Set a parameter and read it back.

        Args:
            name: name of the parameter.
            value: value to set.

        Returns:
            PX4's value afterwards; None if PX4 does not know the parameter.

        Raises:
            LinkSilentError: PX4 is no longer heard; it may have the old or the new value.
        """
        if name not in self._kinds and self.read(name) is None:
            return None

        kind = self._kinds[name]
        sent = float(value)
        if kind == _PARAM_INT32:
            sent = _int_as_float(round(value))

        def send() -> None:
            self._link.mav.param_set_send(self.system_id, AUTOPILOT, name.encode(), sent, kind)

        answered = self._value_after(name, send)
        if answered is not None:
            return answered
        return self.read(name)

    def request_storage(self, timeout_s: float) -> int | None:
        """Have PX4 write its parameters to its storage.

        Args:
            timeout_s: longest wait for the acknowledgement [s].

        Returns:
            PX4's MAV_RESULT, which comes before it writes; None if it does not answer.
        """
        self.command(_PREFLIGHT_STORAGE, 1.0)
        end_s = time.monotonic() + timeout_s
        while time.monotonic() < end_s:
            ack = self._link.recv_match(type="COMMAND_ACK", blocking=True, timeout=0.05)
            if ack is None or ack.get_srcSystem() != self.system_id:
                continue
            if ack.command == _PREFLIGHT_STORAGE:
                return int(ack.result)
        return None

    def command(self, command: int, param1: float) -> None:
        """Send a command without waiting for its answer.

        Args:
            command: number of the command, MAV_CMD.
            param1: first parameter of the command; the others are 0.
        """
        others = (0.0,) * 6
        self._link.mav.command_long_send(self.system_id, AUTOPILOT, command, 0, param1, *others)

    def _request(self, name: str) -> None:
        self._link.mav.param_request_read_send(self.system_id, AUTOPILOT, name.encode(), -1)

    def _value_after(self, name: str, send: Callable[[], object]) -> Value | None:
        """Call ``send`` and return the value in PX4's reply to it.

        Return None if PX4 does not reply, but its heartbeat is heard.
        """
        for _ in range(_ATTEMPTS):
            send()
            end_s = time.monotonic() + _ANSWER_S
            while True:
                left_s = end_s - time.monotonic()
                if left_s <= 0.0:
                    break
                reply = self._next_value(left_s)
                if reply is not None and reply.param_id == name:
                    return self._value(reply)

        if self.is_armed() is None:
            raise LinkSilentError(f"PX4 fell silent at {self.endpoint}.")
        return None

    def _next_value(self, timeout_s: float) -> Any:
        """Return the next value that PX4 sends; None if none comes in time."""
        end_s = time.monotonic() + timeout_s
        while True:
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return None

            reply = self._link.recv_match(type="PARAM_VALUE", blocking=True, timeout=left_s)
            if reply is None or not is_of_autopilot(reply, self.system_id):
                continue
            if reply.param_type in (_PARAM_INT32, _PARAM_REAL32):
                self._kinds[reply.param_id] = int(reply.param_type)
                return reply

    def _value(self, reply: Any) -> Value:
        if reply.param_type == _PARAM_INT32:
            return _float_as_int(reply.param_value)
        return float(reply.param_value)


def _int_as_float(value: int) -> float:
    """Return the float that has the same bits as a whole number, as PX4 sends it."""
    (sent,) = struct.unpack("<f", struct.pack("<i", value))
    return float(sent)


def _float_as_int(sent: float) -> int:
    """Return the whole number whose bits PX4 has put into the field of a float."""
    (value,) = struct.unpack("<i", struct.pack("<f", sent))
    return int(value)
