"""Covey's own tests by the condition of the failsafe table that they show.

The file beside this one is printed from the markers of the tests, so that an installed wheel, which
has no tests, can name them.
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
