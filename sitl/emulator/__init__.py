"""The emulator: vehicles, autopilots and motion capture in one world, and the effects of faults on
it.
"""
