"""Converts flights for third-party viewers: Foxglove, Lichtblick, Rerun."""
