"""Numbers that several rooms share."""

GRAVITY_M_S2 = 9.80665

# largest throttle that trajectories, the law and all limits count with; the rest stays for the
# attitude control
MAX_PLANNED_THRUST_FRAC = 0.97
