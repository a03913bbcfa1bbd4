"""The processes and ports of a simulated flight."""
