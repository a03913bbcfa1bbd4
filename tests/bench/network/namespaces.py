"""A network namespace for this process, with one interface whose packets go through a file
descriptor.

Needs root, or a kernel that lets users make user namespaces. Linux has no other way to lose packets
under TCP where netem is missing, as it is in many virtual machines.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import struct
import subprocess
from pathlib import Path

_NEWUSER = 0x10000000
_NEWNET = 0x40000000
_TUNSETIFF = 0x400454CA
_IFF_TUN = 0x0001
_IFF_NO_PI = 0x1000
_NAME = "covey0"


def enter(address: str) -> int:
    """Move this process, which has one thread yet, into a namespace of its own; the descriptor of
    its interface.

    Args:
        address: of the interface, with the length of its prefix.
    Raises:
        OSError: the kernel does not allow it.
    """
    user = os.getuid()
    group = os.getgid()
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_NEWNET if user == 0 else _NEWNET | _NEWUSER) != 0:
        raise OSError(ctypes.get_errno(), "no network namespace")
    if user != 0:
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"0 {user} 1")
        Path("/proc/self/gid_map").write_text(f"0 {group} 1")
    tun = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(tun, _TUNSETIFF, struct.pack("16sH22x", _NAME.encode(), _IFF_TUN | _IFF_NO_PI))
    for words in (f"addr add {address} dev {_NAME}", f"link set {_NAME} up", "link set lo up"):
        subprocess.run(["ip", *words.split()], check=True)
    return tun
