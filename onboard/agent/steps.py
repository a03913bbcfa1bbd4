"""Words and facts of a flight: where in its state a vehicle is, and what the state machine knows at one tick."""

from __future__ import annotations

from enum import Enum

from msgspec import Struct

from onboard.link.autopilot import Landed, Snapshot, Vec3


class Step(Enum):
    """Where in its state the vehicle is; the words are shown to people."""

    IDLE = ""
    OFFBOARD = "waiting for OFFBOARD"
    ARMING = "waiting to be armed"
    LIFTOFF = "lift-off"
    CLIMB = "climb"
    LEG = "on the way"
    ARRIVED = "arrived"
    DESCENT = "descent"
    CONTACT = "on the ground, waiting for PX4"
    PX4 = "PX4 lands"
    TAKEOVER = "taking over from PX4's hold"


class View(Struct, frozen=True):
    """What the flight needs to know at one tick; position and velocity in fleet ENU."""

    now_ns: int
    position_enu_m: Vec3
    velocity_enu_m_s: Vec3
    has_position: bool
    snapshot: Snapshot

    @property
    def is_on_ground(self) -> bool:
        """PX4 says so."""
        return self.snapshot.landed is Landed.ON_GROUND
