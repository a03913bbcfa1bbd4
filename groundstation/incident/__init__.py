"""``covey incident``: what happened in a flight that went wrong, and what would have prevented it.

The safety distance of the fleet file is called the flight's promise here.
"""
