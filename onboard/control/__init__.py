"""Trajectory, backstepping, allocation, and the pipeline that calls all stages in their order;
pure.
"""
