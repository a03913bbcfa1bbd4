"""Mutants of the pure rooms that decide about safety: code with one small mistake each, and whether
a test notices.

    make bench-mutants ARGS="safety --sample 40"     # 40 of the room's mutants
    make bench-mutants ARGS="flight --module state_machine"

A mutant is one comparison, one word (and, or, not), one number or one call that is changed. Which
tests each of them needs, and how it is tried, stands in `mutant_runs`. A survivor is printed with
its line: it wants a test, or a reason why it is no mistake (`mutant_reasons`). `--write` keeps the
figures of whole modules for docs/mutants.md.

mutmut and cosmic-ray do the same for whole programs. The first one puts its variants beside each
function and chooses at run time, which numba does not compile and which the tests that read the
source (tables, rooms, named values) do not accept. The second one changes the files of the working
tree itself, where others may be at work, and knows no map from rooms to their tests.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import math
import random
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from tests.bench import mutant_figures
from tests.bench.mutant_figures import ROOMS, Measured
from tests.bench.mutant_reasons import REASONS, code_of
from tests.bench.mutant_runs import ROOT, Mutant, RoomFails, verdicts

_PROGRESS_EVERY = 50  # mutants
# Beside its own folder: what a room does is shown by the agent's core.
_TESTS_ELSEWHERE = {
    "flight": ("tests/onboard/agent",),
    "supervision": ("tests/onboard/agent",),
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


def mutants_of(file: Path, root: Path = ROOT) -> Iterator[Mutant]:
    """Yield all mutants of a file.

    Args:
        file: relative to the project.
        root: folder of the project.
    """
    text = (root / file).read_text(encoding="utf-8")
    for index, (place, statement, is_in_function) in enumerate(_places(ast.parse(text))):
        for change in _changes(place):
            yield Mutant(
                file=file,
                line=getattr(place, "lineno", 0),
                change=change,
                first_line=statement.lineno,
                last_line=statement.end_lineno or statement.lineno,
                is_in_function=is_in_function,
                make_tree=partial(_changed_tree, text, index, change),
            )


def _changed_tree(text: str, index: int, change: str) -> ast.Module:
    """Return the tree of a file, one of whose places is changed."""
    tree = ast.parse(text)
    place = next(itertools.islice(_places(tree), index, None))[0]
    _apply(place, change)
    return ast.fix_missing_locations(tree)


def _places(
    within: ast.AST, statement: ast.stmt | None = None, is_in_function: bool = False
) -> Iterator[tuple[ast.AST, ast.stmt, bool]]:
    """Yield all places of the code, each with the statement around it, and whether it is executed
    when a function is called, and not when the module is imported.
    """
    for child in ast.iter_child_nodes(within):
        inner_statement = child if isinstance(child, ast.stmt) else statement
        is_in_body = is_in_function
        if isinstance(within, ast.FunctionDef | ast.AsyncFunctionDef):
            is_in_body = is_in_function or child in within.body
        if inner_statement is not None:
            yield child, inner_statement, is_in_body
        yield from _places(child, inner_statement, is_in_body)


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


def _apply(place: ast.AST, change: str) -> None:
    """Make a change in the copy of a tree."""
    if isinstance(place, ast.Compare):
        place.ops = [_COMPARISONS[type(place.ops[0])]()]
    elif isinstance(place, ast.BoolOp):
        place.op = ast.Or() if isinstance(place.op, ast.And) else ast.And()
    elif isinstance(place, ast.UnaryOp):
        place.operand = ast.UnaryOp(ast.Not(), place.operand)  # not not: still a truth value
    elif isinstance(place, ast.Constant):
        assert isinstance(place.value, int | float)
        place.value = _larger(place.value)
    elif isinstance(place, ast.Expr):
        place.value = ast.Constant(None)
    else:
        raise AssertionError(change)


def _larger(value: float) -> float:
    """Return a number by so much larger that it matters: nanoseconds more by half of them."""
    if isinstance(value, int) and abs(value) < _COUNTED:
        return value + 1
    if isinstance(value, int):
        return value * 3 // 2
    return value * 1.5 + 0.1


def _reason(mutant: Mutant) -> str | None:
    """Return why no test can notice a mutant; None where one should."""
    lines = (ROOT / mutant.file).read_text(encoding="utf-8").splitlines()
    code = code_of(lines[mutant.line - 1])
    return REASONS.get((_below_onboard(mutant), code, mutant.change))


def _below_onboard(mutant: Mutant) -> str:
    return mutant.file.relative_to("onboard").as_posix()


def main(words: Sequence[str]) -> int:
    """Try mutants and print the survivors; the exit status is 1 when there are any."""
    parser = argparse.ArgumentParser(prog="make bench-mutants", description=__doc__)
    parser.add_argument("room", choices=ROOMS)
    parser.add_argument("--module", default="*", help="a file of the room, without its ending")
    parser.add_argument("--sample", type=int, help="so many of all, chosen at random")
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="of tests for each, without the slowest"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="keep the figures for the docs")
    options = parser.parse_args(words)

    files = sorted((ROOT / "onboard" / options.room).glob(f"{options.module}.py"))
    mutants = [one for file in files for one in mutants_of(file.relative_to(ROOT))]
    count = len(mutants)
    if options.write and options.sample is not None:
        parser.error("--write takes whole modules: leave --sample out")
    if options.sample is not None:
        mutants = random.Random(options.seed).sample(mutants, min(options.sample, count))

    try:
        tried = _tried(options.room, mutants, options.seconds)
        survivors = _print_all(tried, len(mutants), count)
    except RoomFails as reason:
        print(f"Mutants would prove nothing, because {reason}.")
        return 1

    if options.write:
        mutant_figures.keep(_by_module(mutants, survivors))
    return int(any(_reason(mutant) is None for mutant in survivors))


def _tried(room: str, mutants: Sequence[Mutant], most_s: float) -> Iterator[tuple[Mutant, bool]]:
    """Yield each mutant, and whether it was noticed by its room's own tests, or else elsewhere."""
    elsewhere = _TESTS_ELSEWHERE.get(room, ())
    left = []
    for mutant, is_noticed in verdicts([f"tests/onboard/{room}"], mutants, most_s=most_s):
        if elsewhere and not is_noticed:
            left.append(mutant)
        else:
            yield mutant, is_noticed
    if left:
        yield from verdicts(elsewhere, left, most_s=most_s)


def _print_all(tried: Iterator[tuple[Mutant, bool]], wanted: int, count: int) -> list[Mutant]:
    """Print the survivors, and now and then how far it is; return them."""
    begin_s = time.monotonic()
    survivors = []
    for number, (mutant, is_noticed) in enumerate(tried, start=1):
        if not is_noticed:
            survivors.append(mutant)
            place = f"{mutant.file}:{mutant.line}: {mutant.change}"
            reason = _reason(mutant)
            print(place if reason is None else f"({place}: {reason})", flush=True)
        if number % _PROGRESS_EVERY == 0:
            passed_s = time.monotonic() - begin_s
            print(f"... {number} of {wanted} tried in {passed_s:.0f} s", flush=True)

    listed = sum(_reason(mutant) is not None for mutant in survivors)
    print(
        f"{wanted - len(survivors)} of {wanted} mutants were noticed, "
        f"{listed} survive for a reason; {count} there are."
    )
    return survivors


def _by_module(mutants: Sequence[Mutant], survivors: Sequence[Mutant]) -> dict[str, Measured]:
    """Return the figures of each module."""
    measured = {}
    for file in dict.fromkeys(_below_onboard(mutant) for mutant in mutants):
        count = sum(_below_onboard(mutant) == file for mutant in mutants)
        surviving = [mutant for mutant in survivors if _below_onboard(mutant) == file]
        unexplained = [mutant for mutant in surviving if _reason(mutant) is None]
        measured[file] = Measured(
            mutants=count,
            noticed=count - len(surviving),
            accepted=len(surviving) - len(unexplained),
            survivors=tuple(f"{mutant.line}: {mutant.change}" for mutant in unexplained),
        )
    return measured
