"""``covey agent``: its line in the list of commands; ``onboard.agent.main`` has the options."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from onboard.agent.main import main


def agent(*words: Annotated[str, Parameter(allow_leading_hyphen=True)]) -> int:
    """Fly one vehicle of a fleet, or look after the service that does.

    Args:
        words: --fleet FILE --vehicle NAME, or install, status or logs with these, or deploy
    """
    return main(words)
