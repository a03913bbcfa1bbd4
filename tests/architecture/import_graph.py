"""Draw the rooms and their imports as the code has them: ``python -m tests.architecture.import_graph --write``.

The drawing stands in docs/architecture.md as a Mermaid graph (shown as a picture by most Git hosts and editors); a test
compares it with the code, so it cannot grow old.
"""

from __future__ import annotations

import sys
from pathlib import Path

import grimp

DOCUMENT = Path(__file__).parents[2] / "docs" / "architecture.md"
BEGIN, END = "<!-- imports: begin -->", "<!-- imports: end -->"
PACKAGES = ("onboard", "groundstation", "sitl")
SPLIT = {"onboard": 2, "groundstation": 2, "sitl": 1}


def room(module: str) -> str:
    """The room that a module stands in: onboard and groundstation by folder or file, sitl as a whole."""
    parts = module.split(".")
    if parts[0] == "sitl" and len(parts) > 1 and parts[1] == "server":
        return "sitl.server"
    return ".".join(parts[: SPLIT[parts[0]]])


def edges() -> list[tuple[str, str]]:
    """(importer, imported) between rooms, sorted."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    found = set()
    for importer in graph.modules:
        for imported in graph.find_modules_directly_imported_by(importer):
            pair = room(importer), room(imported)
            if pair[0] != pair[1]:
                found.add(pair)
    return sorted(found)


def mermaid() -> str:
    """The graph as a Mermaid block, one subgraph for each package."""
    pairs = edges()
    rooms = sorted({name for pair in pairs for name in pair})
    lines = ["```mermaid", "graph TD"]
    for package in PACKAGES:
        lines.append(f"  subgraph {package}_ [{package}]")
        lines += [f"    {name}" for name in rooms if name.split(".")[0] == package]
        lines.append("  end")
    lines += [f"  {importer} --> {imported}" for importer, imported in pairs]
    return "\n".join([*lines, "```"])


def drawn() -> str:
    """The block that the document holds now."""
    text = DOCUMENT.read_text(encoding="utf-8")
    return text.split(BEGIN)[1].split(END)[0].strip()


if __name__ == "__main__":
    if "--write" in sys.argv:
        before, _, rest = DOCUMENT.read_text(encoding="utf-8").partition(BEGIN)
        DOCUMENT.write_text(f"{before}{BEGIN}\n{mermaid()}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
    else:
        print(mermaid())
