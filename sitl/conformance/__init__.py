"""What a real PX4 does, as checks against any endpoint: ``covey sitl-check``. Shares no code with the emulator."""
