"""A hook of mkdocs: links from a page to files that are not in docs/ become their names."""

import re
from typing import Any


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return the page with ``[text](../file)`` as ``text``."""
    return re.sub(r"(?<!!)\[([^\]]+)\]\((?:\.\./)+[^)]*\)", r"\1", markdown)
