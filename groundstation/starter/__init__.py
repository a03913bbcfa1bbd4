"""First files for new users: a fleet file and a mission from a few answers."""
