"""Lockstep flights: agents, emulated vehicles, bus and ground run in one process and in simulated
time. ``covey fly --lockstep`` and the tests fly this way.
"""
