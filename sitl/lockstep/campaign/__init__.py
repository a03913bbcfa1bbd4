"""Flights in which a fault is injected: the faults, the flights, and a judge of every tick."""
