"""Vertical speed of simulated vehicles at their first contact with the ground. Pure.

The emulator measures this speed at the end of each flight. The permitted speed depends on how well
the vehicle knew its height, and on whether its agent flew it or PX4 alone.
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from onboard.bus.schema import Telemetry, Truth
from onboard.config.fleet import Vehicle
from onboard.safety.failsafe_table import Condition

# largest vertical speed that counts as a landing, and not as a hard contact [m/s]
LIMIT_BY_POSES_M_S = 0.8
LIMIT_BY_SATELLITES_M_S = 1.0
LIMIT_BLIND_M_S = 1.2
LIMIT_BY_PX4_M_S = 1.6  # PX4's own landing without poses; of 33 with SIH, 32 stayed below

MAX_KEPT = 500  # most contacts that are kept: the hardest ones

# A position that returns in this time before the contact comes too late to slow the vehicle down.
SIGHT_RETURNED_NS = 1_000_000_000

_MAY_BE_BLIND_S = 0.3  # age of telemetry from which the vehicle may have lost its position since
_LINK_IS_FRESH_S = 0.5  # age of PX4's last packet up to which the agent flies the vehicle

_BLIND = {
    Condition.POSITION_STALE.value,
    Condition.POSITION_LOST.value,
    Condition.POSITION_LOST_LONG.value,
    Condition.SATELLITES_LOST.value,
}


class Touchdown(Struct, frozen=True):
    """One landing's first contact with the ground."""

    vehicle: str
    stamp_ns: int  # stamp of the ground truth that reported it
    speed_m_s: float  # downwards
    had_thrust: bool = True  # whether all motors gave thrust; otherwise the vehicle fell
    # whether its agent flew it without a position, until the contact or until shortly before
    is_blind: bool = False
    is_by_px4: bool = False  # whether PX4 alone flew it

    def limit_m_s(self, vehicle: Vehicle) -> float:
        """Return the largest speed that this contact may have.

        Args:
            vehicle: entry of the vehicle in the fleet file.
        """
        return self._limit_m_s(has_poses=vehicle.mocap_required)

    @property
    def hardness(self) -> float:
        """The speed over the largest one that it may have, in a fleet with poses."""
        return self.speed_m_s / self._limit_m_s(has_poses=True)

    def _limit_m_s(self, *, has_poses: bool) -> float:
        if self.is_by_px4:
            return LIMIT_BY_PX4_M_S
        if self.is_blind:
            return LIMIT_BLIND_M_S
        if has_poses:
            return LIMIT_BY_POSES_M_S
        return LIMIT_BY_SATELLITES_M_S

    def is_hard(self, vehicle: Vehicle) -> bool:
        """Return whether a vehicle with all its thrust came down faster than it may."""
        return self.had_thrust and self.speed_m_s > self.limit_m_s(vehicle)

    def has_fallen(self, vehicle: Vehicle) -> bool:
        """Return whether a vehicle came down without its thrust, faster than any landing."""
        return is_fall(self.speed_m_s, self.limit_m_s(vehicle), had_thrust=self.had_thrust)

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
    """Return whether a vehicle reports that it flies without knowing its position."""
    return not telemetry.is_position_valid or not _BLIND.isdisjoint(telemetry.conditions)


def is_fall(speed_m_s: float, limit_m_s: float, *, had_thrust: bool) -> bool:
    """Return whether a contact is that of a fall: without thrust, and faster than any landing.

    Args:
        speed_m_s: downwards.
        limit_m_s: largest speed of a landing.
        had_thrust: whether all motors gave thrust.
    """
    return not had_thrust and speed_m_s > limit_m_s


def touchdown_of(
    truth: Truth,
    before: Truth | None,
    telemetry: Telemetry | None,
    *,
    telemetry_age_s: float,
    is_fresh: bool,
    was_blind: bool,
) -> Touchdown | None:
    """Return the contact that a ground truth reports for the first time; None if there is none.

    Args:
        truth: newest ground truth of the vehicle.
        before: ground truth before that; None for the first, which may report earlier contacts.
        telemetry: last telemetry of the vehicle.
        telemetry_age_s: its age.
        is_fresh: whether that telemetry is fresh enough to show who flies the vehicle.
        was_blind: whether the vehicle has reported a blind flight within
            :data:`SIGHT_RETURNED_NS`.
    """
    if before is None or truth.touchdowns <= before.touchdowns:
        return None

    is_by_px4 = True  # unless fresh telemetry shows that an agent flew it
    is_blind = False
    if telemetry is not None and is_fresh:
        is_linked = telemetry.autopilot_age_s < _LINK_IS_FRESH_S
        # The state counts as well as the mode, because a failed agent sends no setpoints, and PX4
        # reports its mode only once a second.
        is_working = telemetry.state != "failed" and is_linked
        is_flown_by_agent = telemetry.mode == "OFFBOARD" and is_working
        # The simulator knows at once when PX4 has left OFFBOARD, or follows no setpoints.
        is_by_px4 = not (is_flown_by_agent and truth.is_flown_by_agent)
        may_be_blind = telemetry_age_s > _MAY_BE_BLIND_S
        is_blind = was_blind or may_be_blind or is_flown_blind(telemetry)

    return Touchdown(
        vehicle=truth.vehicle,
        stamp_ns=truth.stamp_ns,
        speed_m_s=truth.touchdown_m_s,
        had_thrust=truth.had_thrust,
        is_blind=is_blind,
        is_by_px4=is_by_px4,
    )


def with_touchdowns(
    contacts: tuple[Touchdown, ...], newest: Sequence[Touchdown]
) -> tuple[Touchdown, ...]:
    """Return the contacts with some more; if there are too many, drop the softest ones.

    Args:
        contacts: contacts so far, oldest first.
        newest: the newest contacts.
    """
    kept = [*contacts, *newest]
    while len(kept) > MAX_KEPT:
        kept.remove(min(kept, key=lambda contact: contact.hardness))
    return tuple(kept)
