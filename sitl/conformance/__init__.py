"""Behaviour of a real PX4 as checks of any endpoint: ``covey sitl-check``. Shares no code with the
emulator.
"""
