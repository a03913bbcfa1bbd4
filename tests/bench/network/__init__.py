"""Benchmarks of the bus over a bad network."""
