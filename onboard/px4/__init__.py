"""PX4 over MAVLink, and the parameters that it must have."""
