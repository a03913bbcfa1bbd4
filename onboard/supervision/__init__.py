"""Applies the safety rules at each tick: finds the conditions that hold, and what follows from
them.
"""
