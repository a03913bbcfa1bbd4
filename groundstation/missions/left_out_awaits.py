"""Notes where a Python mission or a script has left out an ``await``.

Without it, Python calls a verb such as ``fleet.takeoff()`` and does nothing of it. Python only
warns of that, when it deletes what the call has returned.
"""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Iterator

_PYTHONS_WORDS = "coroutine .* was never awaited"


@contextlib.contextmanager
def left_out_awaits() -> Iterator[list[str]]:
    """Note each call in this block that was never awaited.

    Yields:
        A sentence for each of them, which the block adds to while it runs.
    """
    sentences: list[str] = []
    with warnings.catch_warnings():
        show_other = warnings.showwarning

        def note(message: Warning | str, *details: object, **more: object) -> None:
            if "was never awaited" not in str(message):
                show_other(message, *details, **more)  # type: ignore[arg-type]
                return
            sentence = _sentence_of(str(message))
            if sentence not in sentences:
                sentences.append(sentence)

        warnings.filterwarnings("always", _PYTHONS_WORDS, RuntimeWarning)
        warnings.showwarning = note
        depth = sys.get_coroutine_origin_tracking_depth()
        sys.set_coroutine_origin_tracking_depth(1)  # the warning then names the line of the call
        try:
            yield sentences
        finally:
            sys.set_coroutine_origin_tracking_depth(depth)


def _sentence_of(message: str) -> str:
    """Return Python's warning in one line.

    Args:
        message: "coroutine 'Group.takeoff' was never awaited", then a line that introduces the
            line of the call, then that line.
    """
    what, *origin = message.splitlines()
    where = ": ".join(line.strip() for line in origin[1:])
    sentence = f"{what}, so nothing of it was done. Write 'await' before it."
    if not where:
        return sentence
    return f"{where}: {sentence}"
