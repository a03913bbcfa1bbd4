"""The agent as a process of its system: priorities, systemd, a background queue."""
