"""The error of wrong configuration."""

_LONGEST_LINE = 3000  # letters; the names of 255 vehicles take two thirds of that
_KEPT = 300  # letters at each end of a longer line


class ConfigError(ValueError):
    """Wrong input from a person: a sentence with file, key, bound and what to do. Exit status 2.

    A value of the file that it quotes may be of any length. So the middle of a line that nobody
    would read is left out.

    Args:
        sentence: of one line or more.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__("\n".join(map(_shortened, sentence.split("\n"))))


def _shortened(line: str) -> str:
    if len(line) <= _LONGEST_LINE:
        return line

    left_out = len(line) - 2 * _KEPT
    return f"{line[:_KEPT]} ... ({left_out} letters left out) ... {line[-_KEPT:]}"
