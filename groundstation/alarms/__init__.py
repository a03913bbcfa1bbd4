"""Alarms for the operator: a table of conditions, and the alarms that hold now."""
