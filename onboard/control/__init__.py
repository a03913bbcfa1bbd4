"""Trajectory, backstepping, allocation, and the pipeline that calls all stages in order. Pure."""
