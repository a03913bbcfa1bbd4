"""The node of corrections: reads the fleet's source once, and publishes its frames on the bus."""
