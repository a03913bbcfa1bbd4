"""Numbers that several packages share."""

GRAVITY_M_S2 = 9.80665

# largest throttle that trajectories, the law and all limits use; the rest is reserved for attitude
# control
MAX_PLANNED_THRUST_FRAC = 0.97
