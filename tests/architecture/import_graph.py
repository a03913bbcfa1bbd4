"""The rooms and their imports as the code has them, as a Mermaid graph: a picture in most Git hosts and editors."""

from __future__ import annotations

import grimp

PACKAGES = ("onboard", "groundstation", "sitl")
SPLIT = {"onboard": 2, "groundstation": 2, "sitl": 1}
ROOTS = ("server", "campaign", "lockstep", "conformance")  # rooms of sitl that stand apart from the emulator


def room(module: str) -> str:
    """The room that a module stands in: onboard and groundstation by folder or file, the emulator as a whole."""
    parts = module.split(".")
    if parts[0] == "sitl" and len(parts) > 1 and parts[1] in ROOTS:
        return ".".join(parts[:2])
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
