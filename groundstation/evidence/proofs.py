"""The names of Covey's own tests, by the condition of the failsafe table that they show.

They are read from ``proofs.toml``, which is printed from the markers of the tests. So an installed
wheel, which contains no tests, can name them, too.
"""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files

PROOFS_NAME = "proofs.toml"


@cache
def tests_by_condition() -> dict[str, tuple[str, ...]]:
    """Return names of tests, as ``file::test``, by the condition."""
    text = files(__package__).joinpath(PROOFS_NAME).read_text(encoding="utf-8")
    tests = tomllib.loads(text)["tests"]
    return {condition: tuple(names) for condition, names in tests.items()}
