"""Faults of the emulator: their table, and faults of poses and of links."""
