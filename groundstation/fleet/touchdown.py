"""Vertical speed of simulated vehicles at their first contact with the ground. Pure.

The emulator measures it, by its physics, at the end of each flight. How hard a landing may be
depends on what the vehicle knew of its height: to millimetres by a motion capture, to half a metre
by satellites, less by dead reckoning, and on whether its agent flew it at all.
"""

from __future__ import annotations

from msgspec import Struct

from onboard.bus.schema import Telemetry, Truth
from onboard.config.fleet import Vehicle
from onboard.safety.failsafe_table import Condition

# largest vertical speed of a landing that counts as one [m/s]
LIMIT_BY_POSES_M_S = 0.8
LIMIT_BY_SATELLITES_M_S = 1.0
LIMIT_BLIND_M_S = 1.2
# PX4's own landing without poses: of 33 on real PX4s (SIH) most had 0.64 to 1.04 m/s, five 1.2 to
# 1.5, one 2.3
LIMIT_BY_PX4_M_S = 1.6

# A vehicle that sees its position again so shortly before the ground comes down as it did without:
# it has learned its height anew, and has no height left to slow down in.
SIGHT_RETURNED_NS = 1_000_000_000

_LINK_IS_FRESH_S = 0.5  # younger packets of PX4: its agent flies it

_BLIND = {
    Condition.POSITION_STALE.value,
    Condition.POSITION_LOST.value,
    Condition.POSITION_LOST_LONG.value,
    Condition.SATELLITES_LOST.value,
}


class Touchdown(Struct, frozen=True):
    """One landing's first contact with the ground."""

    vehicle: str
    stamp_ns: int  # of the truth that told it
    speed_m_s: float  # downwards
    had_thrust: bool = True  # False: its motors were off, weak or dead; then it fell
    # its agent flew it without seeing its position, until now or until just before
    is_blind: bool = False
    is_by_px4: bool = False  # PX4 alone flew it

    def limit_m_s(self, vehicle: Vehicle) -> float:
        """Return the largest speed that this contact may have.

        Args:
            vehicle: entry of the vehicle in the fleet file.
        """
        if self.is_by_px4:
            return LIMIT_BY_PX4_M_S
        if self.is_blind:
            return LIMIT_BLIND_M_S
        if vehicle.mocap_required:
            return LIMIT_BY_POSES_M_S
        return LIMIT_BY_SATELLITES_M_S

    def is_hard(self, vehicle: Vehicle) -> bool:
        """Return whether a vehicle with all its thrust came down faster than it may."""
        return self.had_thrust and self.speed_m_s > self.limit_m_s(vehicle)

    def has_fallen(self, vehicle: Vehicle) -> bool:
        """Return whether a vehicle came down without its thrust, faster than any landing."""
        return not self.had_thrust and self.speed_m_s > self.limit_m_s(vehicle)

    def sentence(self, vehicle: Vehicle) -> str:
        """Return the contact in words."""
        if not self.had_thrust:
            return (
                f"{self.vehicle} fell, and hit the ground with {self.speed_m_s:.2f} m/s: "
                "its motors were off, weak or dead"
            )
        return (
            f"{self.vehicle} touched down with {self.speed_m_s:.2f} m/s; "
            f"at most {self.limit_m_s(vehicle):.1f} m/s is right for how it flew"
        )


def is_flown_blind(telemetry: Telemetry) -> bool:
    """Return whether a vehicle tells that it flies without seeing its position."""
    return not telemetry.is_position_valid or not _BLIND.isdisjoint(telemetry.conditions)


def touchdown_of(
    truth: Truth,
    before: Truth | None,
    telemetry: Telemetry | None,
    *,
    is_fresh: bool,
    was_blind: bool,
) -> Touchdown | None:
    """Return the contact that a truth tells for the first time; None while it tells no new one.

    Args:
        truth: newest of the vehicle.
        before: the one before it; None before the first, which may tell old ones.
        telemetry: last received of the vehicle.
        is_fresh: whether that is of the present.
        was_blind: whether the vehicle told within :data:`SIGHT_RETURNED_NS` that it flies blind.
    """
    if before is None or truth.touchdowns <= before.touchdowns:
        return None

    is_by_px4 = True
    is_blind = False
    if telemetry is not None and is_fresh:
        is_linked = telemetry.autopilot_age_s < _LINK_IS_FRESH_S
        # a failed agent sends no setpoints; PX4 tells its mode once a second only
        is_flown = telemetry.state != "failed" and is_linked
        is_by_px4 = telemetry.mode != "OFFBOARD" or not is_flown
        is_blind = was_blind or is_flown_blind(telemetry)

    return Touchdown(
        vehicle=truth.vehicle,
        stamp_ns=truth.stamp_ns,
        speed_m_s=truth.touchdown_m_s,
        had_thrust=truth.had_thrust,
        is_blind=is_blind,
        is_by_px4=is_by_px4,
    )
