"""The agent as a process: priorities, systemd, deployment, a background queue."""
