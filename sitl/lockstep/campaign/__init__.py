"""Flights in which something breaks: what can break, and a judge who looks at every tick."""
