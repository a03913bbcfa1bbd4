"""Processes and ports of a simulated flight."""
