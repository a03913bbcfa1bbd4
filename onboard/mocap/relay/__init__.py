"""The relay from a motion-capture system to the fleet's bus, and the check of its bodies."""
