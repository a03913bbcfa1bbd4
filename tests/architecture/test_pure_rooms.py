"""The pure rooms keep no state between calls and do not ask the operating system."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from tests.architecture.form import PURE_ROOMS, ROOT

# the compiled functions of a batch are kept for the process
ALLOWED = {"onboard/rollout/loops.py"}
_CACHES = {"cache", "lru_cache"}
_CHANGES = {
    "append",
    "add",
    "update",
    "setdefault",
    "pop",
    "clear",
    "extend",
    "insert",
    "remove",
    "discard",
}


def _trees() -> Iterator[tuple[str, ast.Module]]:
    for room in PURE_ROOMS:
        for path in sorted((ROOT / "onboard" / room).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if name not in ALLOWED:
                yield name, ast.parse(path.read_text(encoding="utf-8"))


def _module_names(tree: ast.Module) -> set[str]:
    targets = [t for node in tree.body if isinstance(node, ast.Assign) for t in node.targets]
    targets += [node.target for node in tree.body if isinstance(node, ast.AnnAssign)]
    return {target.id for target in targets if isinstance(target, ast.Name)}


def _written(function: ast.AST, names: set[str]) -> Iterator[str]:
    """Names of the module that a function changes."""
    for node in ast.walk(function):
        target: ast.AST | None = None
        if isinstance(node, ast.Global):
            yield from node.names
        elif isinstance(node, ast.Subscript) and isinstance(node.ctx, (ast.Store, ast.Del)):
            target = node.value
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in _CHANGES
        ):
            target = node.func.value
        if isinstance(target, ast.Name) and target.id in names:
            yield target.id


def test_no_function_of_a_pure_room_writes_to_its_module_or_caches() -> None:
    for name, tree in _trees():
        names = _module_names(tree)
        for node in ast.walk(tree):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                local = {
                    n.id
                    for n in ast.walk(node)
                    if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
                }
                assert not list(_written(node, names - local)), f"{name}: {node.name}"
                decorators = {
                    n.id
                    for d in node.decorator_list
                    for n in ast.walk(d)
                    if isinstance(n, ast.Name)
                }
                assert not decorators & _CACHES, f"{name}: {node.name}"


def test_no_pure_room_imports_os() -> None:
    for name, tree in _trees():
        for node in ast.walk(tree):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            modules += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert "os" not in {module.partition(".")[0] for module in modules}, name
