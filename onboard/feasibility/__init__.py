"""Checks whether a fleet can fly as its file configures it, before it flies; pure."""
