"""Checks of an endpoint against the behaviour of a real PX4: `covey check endpoint`.

The checks share no code with the emulator.
"""
