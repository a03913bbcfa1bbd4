"""The emulator's streams of random numbers.

Each part of a simulated flight draws from a stream of its own, so that a change of one part does
not change the random numbers of another. A generator is made of the flight's seed, the stream's
number and, where a stream is one for each vehicle, the vehicle's index:
``default_rng([seed, Stream.WIRES, index])``. NumPy pads these numbers with zeros: a stream with an
index may not have the number of a stream without one.
"""

from __future__ import annotations

from enum import IntEnum, unique


@unique
class Stream(IntEnum):
    """Numbers of the streams."""

    VEHICLES = 1  # motors and sensors of the physics
    ESTIMATES = 2  # errors of PX4's estimator
    MOCAP = 3  # noise of the motion capture
    AIR = 4  # gusts of the air
    OWN_GUSTS = 5  # gusts of single vehicles
    SCATTER = 6  # differences from the type, for each vehicle
    VIEW = 7  # noise of the sensors in MAVLink messages, for each vehicle
    DRIFT = 8  # slow errors of satellites and dead reckoning, for each vehicle
    WIRES = 9  # lost and delayed bytes, for each channel
    BUS = 11  # lost and delayed messages of the bus, in lockstep
    DIRECT_LINK = 12  # the ground's own link to PX4, in lockstep
    RADIO = 13  # packets on the radio channel
    SWITCHED_ON = 14  # moments at which PX4s were switched on
    ODOMETRY = 15  # noise and drift of the cameras on vehicles
