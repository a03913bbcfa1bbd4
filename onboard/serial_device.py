"""A serial device for MAVLink: opened raw, without flow control, never blocking."""

from __future__ import annotations

import os
import termios
import tty

from onboard.config.endpoints import split_serial


def open_serial(endpoint: str) -> int:
    """Open the device of an endpoint.

    Args:
        endpoint: The endpoint as written in the fleet file, ``serial://DEVICE:BAUD``.
    Returns:
        The file descriptor of the device.
    Raises:
        ValueError: The endpoint is malformed.
        OSError: The device does not exist, is not a serial device, or must not be used.
    """
    device, speed = split_serial(endpoint)
    descriptor = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        tty.setraw(descriptor)
        attributes = termios.tcgetattr(descriptor)
        # termios(3): item 2 holds the control flags, 4 the input speed and 5 the output speed
        attributes[2] = attributes[2] & ~termios.CRTSCTS | termios.CLOCAL | termios.CREAD
        attributes[4] = speed
        attributes[5] = speed
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    except termios.error as error:
        os.close(descriptor)
        raise OSError(f"{device} is no serial device ({error})") from None
    return descriptor
