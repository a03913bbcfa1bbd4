"""Behaviour of a real PX4 as checks of any endpoint: `covey check endpoint`.

It shares no code with the emulator.
"""
