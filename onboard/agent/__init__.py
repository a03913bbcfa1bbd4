"""The agent of one vehicle: its core without I/O, and the loop that moves bytes and time."""
