"""The ground's end of the bus, and the direct path to PX4."""
