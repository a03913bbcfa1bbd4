"""PX4 autopilots, their vehicles and their world, as a MAVLink client and a motion capture see
them.
"""
