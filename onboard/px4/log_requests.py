"""Decides which requests for PX4's own logs an agent forwards to its PX4. Pure.

A ground station sends the requests as whole MAVLink packets. MAVLink's file transfer can also
write, delete and read every file on PX4's card. The agent forwards only what fetching a log needs:
requests that list or read below PX4's log folders, and the LOG_DATA requests, which only read.

Layout of a file transfer payload: three ids, sequence (2 bytes), session, operation, size,
answered operation, end of the burst, padding, offset (4 bytes), data. Source: MAVLink's
documentation, "File Transfer Protocol".
"""

from __future__ import annotations

from onboard.autopilot import AUTOPILOT_COMPONENT
from onboard.px4.packets import FILE_TRANSFER, LOG_REQUESTS, Packet

LOG_FOLDERS = ("/fs/microsd/log", "/log")  # on a flight controller, and in a simulated PX4
LOG_SUFFIX = ".ulg"

# message number -> offset in its payload of the ids of the requested system and component
_TARGET_AT = {
    FILE_TRANSFER: 1,
    117: 4,  # LOG_REQUEST_LIST
    119: 10,  # LOG_REQUEST_DATA
    122: 0,  # LOG_REQUEST_END
}
_MAX_BYTES = 255  # largest payload; MAVLink removes zeros at its end

# offsets in a file transfer payload
_OPERATION_AT = 6
_SIZE_AT = 7
_DATA_AT = 15

# operations of file transfer
_TERMINATE = 1
_RESET = 2
_LIST = 3
_OPEN_TO_READ = 4
_READ = 5
_BURST = 15
# These operations read or close the open file, which is a log.
_WITHOUT_PATH = (_TERMINATE, _RESET, _READ, _BURST)


def is_allowed(packet: Packet, system_id: int) -> bool:
    """Return whether a request only reads logs of this vehicle's autopilot.

    Args:
        packet: the request of a ground station.
        system_id: MAVLink id of the vehicle.
    """
    if packet.number not in LOG_REQUESTS or not packet.has_right_checksum:
        return False

    payload = packet.payload.ljust(_MAX_BYTES, b"\0")
    target_at = _TARGET_AT[packet.number]
    target = tuple(payload[target_at : target_at + 2])
    if target != (system_id, AUTOPILOT_COMPONENT):
        return False

    if packet.number != FILE_TRANSFER:
        return True
    return _only_reads_logs(payload)


def _only_reads_logs(payload: bytes) -> bool:
    """Return whether a file transfer request only lists or reads logs."""
    operation = payload[_OPERATION_AT]
    if operation in _WITHOUT_PATH:
        return True

    size = payload[_SIZE_AT]
    path = payload[_DATA_AT : _DATA_AT + size].rstrip(b"\0").decode("utf-8", "replace")
    if operation == _LIST:
        return _is_below_log_folder(path)
    if operation == _OPEN_TO_READ:
        return _is_below_log_folder(path) and path.endswith(LOG_SUFFIX)
    return False


def _is_below_log_folder(path: str) -> bool:
    if ".." in path.split("/"):
        return False
    return any(path == folder or path.startswith(f"{folder}/") for folder in LOG_FOLDERS)
