"""``covey check FILE``: finds errors of a fleet or mission file, and whether it can be flown."""
