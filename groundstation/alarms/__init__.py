"""Alarms for the operator: a table of conditions, and those that hold now."""
