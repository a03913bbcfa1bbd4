"""What happened in a flight that went wrong, and what would have kept its promise."""
