"""What a mission declares about its flight: in ``[expect]``, in a step ``do = "expect"``, in ``EXPECT`` of a script."""

from __future__ import annotations

import msgspec


class Expect(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Expectations.

    As a step: about the flight so far. As ``[expect]``: about the whole mission.
    """

    min_separation_m: float | None = None  # no two centres came nearer
    # each vehicle was so near to its goal when its order was done
    arrived_within_m: float | None = None
    # everybody is down and disarmed; false: it is right that they are not
    all_landed: bool | None = None


# Expectations above these bounds are mistakes of unit.
EXPECT_MOST_M = {"min_separation_m": 100.0, "arrived_within_m": 10.0}
