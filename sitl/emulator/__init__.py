"""The emulator: vehicles, autopilots and motion capture in one world, and effects of faults."""
