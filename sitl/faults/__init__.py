"""Faults that the emulator can be given, as a table; faults of poses and of links."""
