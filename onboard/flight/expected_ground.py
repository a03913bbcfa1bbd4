"""What a flight expects of the ground: where it took off, and where it lands. Pure.

The heights of the fleet file are nominal. The true height of the ground at the take-off is
measured there, and the ground elsewhere differs from it as the file says.
"""

from __future__ import annotations

from typing import NamedTuple

from onboard.flight.contact import LOW_M


class ExpectedGround(NamedTuple):
    """Heights of the ground in the fleet frame [m]."""

    # where the vehicle took off, or where it lands if the file says that it is higher there
    z_m: float = 0.0
    by_file_m: float = 0.0  # height of the same ground by the file
    landing_z_m: float = 0.0  # where the vehicle lands; before a landing the same as z_m

    @property
    def may_be_lower(self) -> bool:
        """Whether the ground is clearly lower at the landing, by the file."""
        return self.landing_z_m < self.z_m - LOW_M

    def z_of(self, by_file_m: float) -> float:
        """Return the height of other ground.

        Args:
            by_file_m: its height by the file.
        """
        return self.z_m + (by_file_m - self.by_file_m)


def ground_of_takeoff(z_m: float, by_file_m: float) -> ExpectedGround:
    """Return what is expected of the ground on which a vehicle stands.

    Args:
        z_m: measured height of this ground.
        by_file_m: its height by the file.
    """
    return ExpectedGround(z_m=z_m, by_file_m=by_file_m, landing_z_m=z_m)


def ground_of_landing(ground: ExpectedGround, here_by_file_m: float) -> ExpectedGround:
    """Return what is expected of the ground of a landing.

    Where it is higher, as on a roof, the expected ground is raised. Where it is lower, it may still
    be as high as at the take-off, because slopes are not known. There the vehicle sinks slowly from
    that height on, and only thrust and motion tell that it stands.

    Args:
        ground: what was expected before.
        here_by_file_m: height of the ground of the landing by the file.
    """
    here_z_m = ground.z_of(here_by_file_m)
    if here_z_m > ground.z_m:
        return ground_of_takeoff(here_z_m, here_by_file_m)
    return ground._replace(landing_z_m=here_z_m)
