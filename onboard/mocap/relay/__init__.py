"""The relay from a motion-capture system to the fleet's bus, and its check."""
