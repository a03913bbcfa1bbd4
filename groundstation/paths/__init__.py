"""Paths of vehicles: their files, their polynomial pieces, and their checks before a flight."""
