"""The network that a fleet flies over: is it fit, who gets in, what this computer adds to it."""
