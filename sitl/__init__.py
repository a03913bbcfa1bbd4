"""Emulation of PX4 autopilots, their vehicles and their world, for MAVLink and motion capture."""
