"""Compiles the law before simulated flights, and says so on standard error if that takes long."""

from __future__ import annotations

import sys
import threading

from onboard.plain_text import fitted
from onboard.rollout import batch

SENTENCE = (
    "covey: compiling the law for this machine; it is kept, and takes about half a minute "
    "this time only"
)
_TOLD_AFTER_S = 2.0  # loading from numba's cache takes less


def compile_law(*, has_own_law: bool = False) -> None:
    """Compile the law for batches, or load it from numba's cache.

    Args:
        has_own_law: whether vehicles fly by a user's own law.
    """
    notice = threading.Timer(_TOLD_AFTER_S, _tell)
    notice.start()
    try:
        batch.warm_up(has_own_law=has_own_law)
    finally:
        notice.cancel()


def _tell() -> None:
    print(fitted(SENTENCE, sys.stderr), file=sys.stderr, flush=True)
