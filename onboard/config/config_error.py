"""The error of wrong configuration."""


class ConfigError(ValueError):
    """Wrong input from a person: a sentence with file, key, bound and what to do. Exit status 2."""
