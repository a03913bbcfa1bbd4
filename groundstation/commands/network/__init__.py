"""Commands about the network that a fleet flies over."""
