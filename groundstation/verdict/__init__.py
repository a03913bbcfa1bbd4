"""Judgement of a flight: what was expected, what was observed, and the verdict."""
