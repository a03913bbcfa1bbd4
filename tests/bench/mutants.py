"""Mutants of the pure rooms that decide about safety: code with one small mistake each, and whether
a test notices.

    make bench-mutants ARGS="safety --sample 40"     # 40 of the room's mutants
    make bench-mutants ARGS="flight --module state_machine"

A mutant is one comparison, one word (and, or, not), one number or one call that is changed. The
room is copied and changed in the copy, and its tests run there, interpreted, up to the first that
fails: those of the mutant's own module first. Each run is a fork of one process that has imported
all libraries. A survivor is printed with its line: it wants a test, or a reason why it is no
mistake (`REASONS`).

mutmut and cosmic-ray do the same for whole programs. The first one puts its variants beside each
function and chooses at run time, which numba does not compile and which the tests that read the
source (tables, rooms, named values) do not accept. The second one changes the files of the working
tree itself, where others may be at work, and knows no map from rooms to their tests.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import importlib
import os
import random
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, NoReturn

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("safety", "flight", "avoidance", "supervision")
_SECONDS = 600  # of a run of tests
# Beside its own folder: what a room does is shown by the agent's core.
_TESTS_ELSEWHERE = {"supervision": ("tests/onboard/agent",)}

# Mutants that no test can notice, by file, line of code and change, and why not.
REASONS = {
    ("geofence.py", "ahead_x_m = east - x if vx > 0.0 else x - west", "Gt becomes GtE"): (
        "who does not move along an axis needs no distance to stop, whichever wall is ahead"
    ),
    (
        "geofence.py",
        "or (vz > 0.0 and self._is_near(top - z, vz, brake_z))",
        "Gt becomes GtE",
    ): "who does not climb needs no distance to stop below the ceiling",
    ("geofence.py", "ahead_y_m = north - y if vy > 0.0 else y - south", "Gt becomes GtE"): (
        "who does not move along an axis needs no distance to stop, whichever wall is ahead"
    ),
}
_COUNTED = 1000  # whole numbers below are counts, others are nanoseconds

_COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}


class Mutant(NamedTuple):
    """One changed file."""

    file: Path  # relative to the repository
    line: int
    change: str
    text: str  # of the whole file


def mutants_of(file: Path) -> Iterator[Mutant]:
    """Yield all mutants of a file.

    Args:
        file: relative to the repository.
    """
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    places = list(ast.walk(tree))
    for index, place in enumerate(places):
        for change in _changes(place):
            mutant = copy.deepcopy(tree)
            twin = list(ast.walk(mutant))[index]
            _apply(twin, change)
            line = getattr(place, "lineno", 0)
            yield Mutant(file, line, change, ast.unparse(ast.fix_missing_locations(mutant)))


def _changes(place: ast.AST) -> Iterator[str]:
    """Yield what may be changed about a place of the code."""
    if (
        isinstance(place, ast.Compare)
        and len(place.ops) == 1
        and type(place.ops[0]) in _COMPARISONS
    ):
        old = type(place.ops[0])
        yield f"{old.__name__} becomes {_COMPARISONS[old].__name__}"
    elif isinstance(place, ast.BoolOp):
        yield "and becomes or" if isinstance(place.op, ast.And) else "or becomes and"
    elif isinstance(place, ast.UnaryOp) and isinstance(place.op, ast.Not):
        yield "not is dropped"
    elif isinstance(place, ast.Constant) and type(place.value) in (int, float):
        yield f"{place.value!r} becomes larger"
    elif isinstance(place, ast.Expr) and isinstance(place.value, ast.Call):
        yield "a call is dropped"


def _apply(twin: ast.AST, change: str) -> None:
    """Make a change in the copy of a tree."""
    if isinstance(twin, ast.Compare):
        twin.ops = [_COMPARISONS[type(twin.ops[0])]()]
    elif isinstance(twin, ast.BoolOp):
        twin.op = ast.Or() if isinstance(twin.op, ast.And) else ast.And()
    elif isinstance(twin, ast.UnaryOp):
        twin.op = ast.UAdd()
        twin.operand = ast.Call(ast.Name("bool", ast.Load()), [twin.operand], [])
    elif isinstance(twin, ast.Constant):
        assert isinstance(twin.value, int | float)
        twin.value = _larger(twin.value)
    elif isinstance(twin, ast.Expr):
        twin.value = ast.Constant(None)
    else:
        raise AssertionError(change)


def _larger(value: float) -> float:
    """Return a number by so much larger that it matters: nanoseconds more by half of them."""
    if isinstance(value, int) and abs(value) < _COUNTED:
        return value + 1
    if isinstance(value, int):
        return value * 3 // 2
    return value * 1.5 + 0.1


def is_noticed(mutant: Mutant, room: str, copy_of_tree: Path) -> bool:
    """Return whether a test of the room fails with a mutant."""
    file = copy_of_tree / mutant.file
    before = file.read_text(encoding="utf-8")
    file.write_text(mutant.text, encoding="utf-8")
    try:
        return _status_of_tests(room, mutant.file.stem, copy_of_tree) != 0
    finally:
        file.write_text(before, encoding="utf-8")


def _status_of_tests(room: str, module: str, copy_of_tree: Path) -> int:
    """Run a room's tests in a fork of this process; return their exit status, or a signal."""
    folder = f"tests/onboard/{room}"
    own = f"{folder}/test_{module}.py"
    paths = [folder, *_TESTS_ELSEWHERE.get(room, ())]
    if (copy_of_tree / own).exists():
        paths.insert(0, own)

    child = os.fork()
    if child == 0:
        _run_tests(paths, copy_of_tree)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def _run_tests(paths: list[str], copy_of_tree: Path) -> NoReturn:
    """Run tests up to the first that fails, and end this process."""
    signal.alarm(_SECONDS)  # a mutant that goes on for ever is noticed by that
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    os.chdir(copy_of_tree)
    sys.path.insert(0, str(copy_of_tree))
    os.environ["COVEY_NUMBA"] = "0"
    sys.dont_write_bytecode = True
    for name in list(sys.modules):  # whatever this process has of the unchanged tree
        if name.partition(".")[0] in ("onboard", "groundstation", "sitl", "tests"):
            del sys.modules[name]

    status = 1
    try:
        words = ["-x", "-q", "-p", "no:cacheprovider", "-m", "not long"]
        status = int(pytest.main([*words, *paths]))
    finally:
        os._exit(status)


def _import_libraries() -> None:
    """Import what every run needs."""
    for name in ("numpy", "hypothesis", "msgspec", "pytest_asyncio", "zenoh", "scipy"):
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def _reason(mutant: Mutant) -> str | None:
    """Return why no test can notice a mutant; None where one should."""
    lines = (ROOT / mutant.file).read_text(encoding="utf-8").splitlines()
    code = lines[mutant.line - 1].strip()
    return REASONS.get((mutant.file.name, code, mutant.change))


def copied_tree(folder: Path) -> Path:
    """Return a tree whose onboard rooms are a copy, and all else are links."""
    tree = folder / "tree"
    tree.mkdir()
    for entry in ROOT.iterdir():
        if entry.name == "onboard":
            left_out = shutil.ignore_patterns("__pycache__")
            shutil.copytree(entry, tree / entry.name, symlinks=True, ignore=left_out)
        elif entry.name not in (".git", ".venv"):
            (tree / entry.name).symlink_to(entry)
    return tree


def main(words: Sequence[str]) -> int:
    """Try mutants and print the survivors; the exit status is 1 when there are any."""
    parser = argparse.ArgumentParser(prog="make bench-mutants", description=__doc__)
    parser.add_argument("room", choices=ROOMS)
    parser.add_argument("--module", default="*", help="a file of the room, without its ending")
    parser.add_argument("--sample", type=int, help="so many of all, chosen at random")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(words)

    files = sorted((ROOT / "onboard" / options.room).glob(f"{options.module}.py"))
    mutants = [one for file in files for one in mutants_of(file.relative_to(ROOT))]
    count = len(mutants)
    if options.sample is not None:
        mutants = random.Random(options.seed).sample(mutants, min(options.sample, count))

    _import_libraries()
    survivors = 0
    listed = 0
    with tempfile.TemporaryDirectory(prefix="covey-mutants-") as folder:
        tree = copied_tree(Path(folder))
        unchanged = files[0].relative_to(ROOT)
        text = files[0].read_text(encoding="utf-8")
        if is_noticed(Mutant(unchanged, 0, "nothing", text), options.room, tree):
            print("The room's tests fail without any change: mutants would prove nothing.")
            return 1
        for mutant in mutants:
            if is_noticed(mutant, options.room, tree):
                continue
            place = f"{mutant.file}:{mutant.line}: {mutant.change}"
            reason = _reason(mutant)
            if reason is None:
                survivors += 1
                print(place, flush=True)
            else:
                listed += 1
                print(f"({place}: {reason})", flush=True)
    noticed = len(mutants) - survivors - listed
    print(
        f"{noticed} of {len(mutants)} mutants were noticed, {listed} survive for a reason; "
        f"{count} there are."
    )
    return int(survivors > 0)
