"""Paths of vehicles: their files, their fit to polynomial pieces, and their checks before a flight."""
