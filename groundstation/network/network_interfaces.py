"""Checks of this computer's network interfaces: their largest packets, and Wi-Fi's power saving."""

from __future__ import annotations

import fcntl
import socket
import struct
from pathlib import Path

from groundstation.network.diagnosis import Diagnosis, Grade, graded

# Requests of ioctl(2).
_GET_WIFI_POWER = 0x8B2D  # SIOCGIWPOWER
_GET_MTU = 0x8921  # SIOCGIFMTU

# struct ifreq and struct iwreq begin with the interface's name; the kernel's answer follows
_NAME_BYTES = 16
_ANSWER_BYTES = 24
_WIFI_POWER_DISABLED = 21  # offset of iw_param.disabled in bytes

_MIN_MTU = 1280  # bytes; QUIC does not connect over an interface with smaller packets
_USUAL_MTU = 1500

_INTERFACES = Path("/sys/class/net")


def interfaces() -> list[Diagnosis]:
    """Return the findings about each network interface but the loopback."""
    try:
        names = sorted(file.name for file in _INTERFACES.iterdir() if file.name != "lo")
    except OSError:
        names = []

    diagnoses = []
    for name in names:
        try:
            state = (_INTERFACES / name / "operstate").read_text().strip()
        except OSError:
            continue  # not an interface, such as bonding_masters, or one that was just removed
        if state == "down":
            continue

        for diagnosis in (_packet_size(name), _wifi_power_saving(name)):
            if diagnosis is not None:
                diagnoses.append(diagnosis)

    if not diagnoses:
        sentence = "No interface but this computer's own."
        diagnoses.append(Diagnosis("network", Grade.WARN, sentence, "Plug in or join one."))
    return diagnoses


def _packet_size(interface: str) -> Diagnosis | None:
    """Return the finding about the largest packets; None if the kernel does not say."""
    answer = _ask_kernel(interface, _GET_MTU)
    if answer is None:
        return None

    (mtu,) = struct.unpack_from("i", answer, _NAME_BYTES)
    return graded(
        f"packets of {interface}",
        mtu >= _USUAL_MTU,
        f"Up to {mtu} bytes.",
        f"ip link set {interface} mtu {_USUAL_MTU}; below {_MIN_MTU} QUIC does not connect.",
        bad=Grade.FAIL if mtu < _MIN_MTU else Grade.WARN,
    )


def _wifi_power_saving(interface: str) -> Diagnosis | None:
    """Return the finding whether Wi-Fi sleeps between packets; None if there is no answer.

    An interface that is not Wi-Fi gives none.
    """
    if not (_INTERFACES / interface / "wireless").exists():
        return None
    answer = _ask_kernel(interface, _GET_WIFI_POWER)
    if answer is None:
        return None

    stays_awake = bool(answer[_WIFI_POWER_DISABLED])
    if stays_awake:
        text = "Wi-Fi stays awake."
    else:
        text = "Wi-Fi sleeps between packets: states come up to 0.1 s late."
    remedy = f"iw dev {interface} set power_save off"
    return graded(f"power of {interface}", stays_awake, text, remedy)


def _ask_kernel(interface: str, request: int) -> bytes | None:
    """Return the kernel's answer about an interface; None if it gives none."""
    name = interface.encode()[: _NAME_BYTES - 1].ljust(_NAME_BYTES, b"\0")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        try:
            return fcntl.ioctl(any_socket.fileno(), request, name + bytes(_ANSWER_BYTES))
        except OSError:
            return None
