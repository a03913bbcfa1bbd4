"""The error for a wrong configuration."""

_LONGEST_LINE = 3000  # characters; the names of 255 vehicles take two thirds of this
_KEPT = 300  # characters kept at each end of a longer line


class ConfigError(ValueError):
    """Wrong input from a person. Commands end with exit status 2.

    The message is a sentence with the file, the key, the bound and what to do. It may quote a value
    of any length, so the middle of a very long line is omitted.

    Args:
        sentence: message of one or more lines.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__("\n".join(map(_shortened, sentence.split("\n"))))


def _shortened(line: str) -> str:
    """Return a line without the middle of a very long one."""
    if len(line) <= _LONGEST_LINE:
        return line

    left_out = len(line) - 2 * _KEPT
    return f"{line[:_KEPT]} ... ({left_out} letters left out) ... {line[-_KEPT:]}"
