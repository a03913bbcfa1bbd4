"""Behaviour of a real PX4 as checks of any endpoint: ``covey check endpoint``. Shares no code with the
emulator.
"""
