"""Measures of the form of the code: names, docstrings, circles of imports.

``python -m tests.architecture.form`` prints each figure with its limit and the places past it.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PACKAGES = ("onboard", "groundstation", "sitl")
PURE_ROOMS = ("control", "avoidance", "estimation", "safety", "feasibility", "rollout")
# names that a newcomer would have to learn: docs/glossary.md has the words to use instead
RIDDLES = frozenset(
    "told asked found place who wish need lack brief seen lives telling outbox give stage "  # noqa: SIM905
    "watching dress look captured choose second_opinion foreign proc handle proposal forecaster "
    "dear ticks wire guard leaving ordering stand news lean way".split()
)
_RELATIVE = re.compile(
    r"(What|Who|Whose|Whom|Where|Which|When|Why|How|Does|Is|Are|Can|May|Has|Must)\b"
)
_SECOND_TEXT = re.compile(r"kernel|fused|compiled|_one\.py$")
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Module:
    """One file of the product."""

    name: str  # dotted
    path: str  # from the root, with slashes
    text: str
    tree: ast.Module
    nodes: tuple[ast.AST, ...]  # all of the tree: it takes long to walk

    @property
    def room(self) -> str:
        """The folder, two levels deep."""
        return "/".join(self.path.split("/")[:-1][:2])

    @property
    def is_pure(self) -> bool:
        """Whether it belongs to a pure room."""
        return self.path.startswith(tuple(f"onboard/{room}/" for room in PURE_ROOMS))

    @property
    def is_front_door(self) -> bool:
        """Whether its imports inside functions are late on purpose."""
        return self.path.startswith("groundstation/commands/") or self.path in {
            "groundstation/cli.py", "groundstation/__main__.py", "onboard/__main__.py",
            "sitl/__main__.py",
        }  # fmt: skip


class Figure(NamedTuple):
    """One measure: the places that count, and how many there may be."""

    name: str
    places: list[str]
    limit: int


@cache
def modules() -> tuple[Module, ...]:
    """Return all modules of the product."""
    result = []
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        relative = path.relative_to(ROOT)
        text = path.read_text(encoding="utf-8")
        parts = relative.with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        tree = ast.parse(text)
        module = Module(
            name=name,
            path=relative.as_posix(),
            text=text,
            tree=tree,
            nodes=tuple(ast.walk(tree)),
        )
        result.append(module)
    return tuple(result)


def circles(edges: dict[str, set[str]]) -> list[str]:
    """Return the strongly connected groups of more than one node (Kosaraju)."""
    order: list[str] = []
    visited: set[str] = set()
    backward: dict[str, set[str]] = defaultdict(set)
    for source, targets in edges.items():
        for target in targets:
            backward[target].add(source)

    def collect(start: str, graph: dict[str, set[str]], done: set[str]) -> list[str]:
        """Return the nodes that can be reached and were not visited, each after its successors."""
        reached = []
        stack = [(start, iter(graph.get(start, ())))]
        done.add(start)
        while stack:
            node, successors = stack[-1]
            following = next((other for other in successors if other not in done), None)
            if following is None:
                reached.append(node)
                stack.pop()
            else:
                done.add(following)
                stack.append((following, iter(graph.get(following, ()))))
        return reached

    for node in edges:
        if node not in visited:
            order += collect(node, edges, visited)
    groups = []
    assigned = set[str]()
    for node in reversed(order):
        if node not in assigned:
            group = collect(node, backward, assigned)
            if len(group) > 1:
                groups.append(" <-> ".join(sorted(group)))
    return groups


def imports(module: Module, names: set[str], *, with_late: bool = False) -> set[str]:
    """Return the modules of the product that a module imports, also inside functions.

    Args:
        names: all modules of the product.
        with_late: count what the front door imports inside functions as well.
    """
    late: set[ast.AST] = set()
    if module.is_front_door and not with_late:
        late = {
            node
            for function in module.nodes
            if isinstance(function, _FUNCTIONS)
            for node in ast.walk(function)
        }
    targets = set()
    for node in module.nodes:
        if node in late:
            continue
        if isinstance(node, ast.Import):
            targets |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                targets.add(full if full in names else node.module)
    return (targets & names) - {module.name}


def _functions(
    kept: list[Module],
) -> Iterator[tuple[Module, ast.FunctionDef | ast.AsyncFunctionDef]]:
    for module in kept:
        for node in module.nodes:
            if isinstance(node, _FUNCTIONS):
                yield module, node


def _parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    arguments = function.args
    return [
        argument.arg
        for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)
    ]


def _name_figures() -> Iterator[Figure]:
    files = [m.path for m in modules() if not m.path.endswith(("__init__.py", "__main__.py"))]
    stems = [path.rpartition("/")[2] for path in files]
    yield Figure(
        "file names that stand more than twice",
        [n for n, count in Counter(stems).items() if count > 2],
        6,
    )
    classes = Counter(
        n.name
        for m in modules()
        for n in m.nodes
        if isinstance(n, ast.ClassDef) and n.name[0] != "_"
    )
    yield Figure(
        "class names that stand more than twice",
        [n for n, count in classes.items() if count > 2],
        2,
    )
    yield Figure(
        "module names that are riddles", [path for path in files if Path(path).stem in RIDDLES], 0
    )
    yield Figure(
        "second texts of one idea", [path for path in files if _SECOND_TEXT.search(path)], 0
    )
    numba = [
        m.path for m in modules() if re.search(r"^\s*(import|from) numba\b", m.text, re.MULTILINE)
    ]
    yield Figure("modules that import numba", numba, 2)


def _docstring_figures() -> Iterator[Figure]:
    relative = [
        f"{m.path}:{node.lineno} {node.name}"
        for m in modules()
        for node in m.nodes
        if isinstance(node, (*_FUNCTIONS, ast.ClassDef))
        and _RELATIVE.match(ast.get_docstring(node) or "")
    ]
    yield Figure("docstrings that begin with a relative clause or a question", relative, 25)
    public = [
        (m, f)
        for m, f in _functions([module for module in modules() if module.is_pure])
        if not f.name.startswith("_") and set(_parameters(f)) - {"self", "cls"}
    ]
    without = [
        f"{m.path}:{f.lineno} {f.name}"
        for m, f in public
        if "Args:" not in (ast.get_docstring(f) or "")
    ]
    yield Figure(
        "public functions of the pure rooms without Args", without, round(0.35 * len(public))
    )


def _circle_figures() -> Iterator[Figure]:
    by_name = {module.name: module for module in modules()}
    edges = {name: imports(module, set(by_name)) for name, module in by_name.items()}
    rooms: dict[str, set[str]] = defaultdict(set)
    for source, targets in edges.items():
        for target in targets:
            a = by_name[source].room
            b = by_name[target].room
            # what lies beside the rooms belongs to all of them
            if a != b and not {a, b} & set(PACKAGES):
                rooms[a].add(b)
    yield Figure("circles of files", circles(edges), 0)
    yield Figure("circles of rooms", circles(dict(rooms)), 0)


def figures() -> list[Figure]:
    """Return all measures."""
    return [*_name_figures(), *_docstring_figures(), *_circle_figures()]


if __name__ == "__main__":
    for figure in figures():
        print(f"{len(figure.places):4} (at most {figure.limit}) {figure.name}")
        for line in figure.places if len(figure.places) > figure.limit or "-v" in sys.argv else ():
            print(f"       {line}")
