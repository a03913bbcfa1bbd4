"""Flight records: written, read, reported and played back."""
