"""Mission files, TOML and Python: their steps, how they are read and checked, and their expected course."""
