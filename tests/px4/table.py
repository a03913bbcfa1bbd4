"""The table of docs/px4-sitl.md about one version of PX4."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs/px4-sitl.md"
ROWS = 20  # of a whole run
_BEGIN = "<!-- test-px4: begin -->"
_END = "<!-- test-px4: end -->"


@dataclass(slots=True)
class Table:
    """Rows measured with one build."""

    build: str
    rows: list[tuple[str, str]] = field(default_factory=list)

    @property
    def text(self) -> str:
        """As Markdown, below the name of the build."""
        lines = [f"### {self.build}", "", "| flown | what happened |", "|---|---|"]
        return "\n".join([*lines, *(f"| {what} | {result} |" for what, result in self.rows)])

    def add(self, what: str, result: str) -> None:
        """Add a row."""
        self.rows.append((what, result))

    def write(self, page: Path = PAGE) -> None:
        """Put it into the page, in the place of an older one of the same version."""
        before, _, rest = page.read_text(encoding="utf-8").partition(_BEGIN)
        inside, _, after = rest.partition(_END)
        sections = [text.strip() for text in re.split(r"(?m)^(?=### )", inside) if text.strip()]
        version = self.build.partition(" ")[0]
        kept = [text for text in sections if not text.startswith(f"### {version} ")]
        middle = "\n\n".join(sorted([*kept, self.text]))
        page.write_text(f"{before}{_BEGIN}\n\n{middle}\n\n{_END}{after}", encoding="utf-8")
