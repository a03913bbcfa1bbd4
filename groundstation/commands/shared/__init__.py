"""What several commands share and no command is: one flight from its processes to its verdict."""
