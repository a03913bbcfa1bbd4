"""PX4 itself, past the agents: its parameters, versions, state and signing keys."""
