"""Mission files, TOML and Python: their steps, reading, checks, and expected course."""
