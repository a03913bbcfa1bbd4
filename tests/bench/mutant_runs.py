"""Whether a test notices a mutant, found out with as few tests as possible.

All tests of a room are imported once, and each of them runs once in a fork of that process while
`sys.settrace` writes down which lines of the room it executes. A mutant then needs only the tests
that execute the changed statement, the fastest first, up to the first that fails.

A change inside a function is put into a fork of the process that has imported everything: the
function gets another code object, and no file is written. What runs while modules are imported
(constants, tables, defaults of arguments) has already had its effect there. A mutant of that kind
is imported anew in a fork of a process that knows libraries only. Any test of the room may use the
value; those that execute a function of its file run first.

Numba is off, so that each line is Python's.
"""

from __future__ import annotations

import ast
import contextlib
import gc
import importlib
import math
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, FrameType, FunctionType, TracebackType
from typing import Any, NamedTuple, TypeVar

import pytest

ROOT = Path(__file__).parents[2]
_PYTEST_WORDS = (
    *("-q", "-s", "-p", "no:cacheprovider", "-m", "not long and not realtime"),
    *("--tb=native", "--assert=plain"),  # nobody reads why a test fails
)
_OUR_PACKAGES = ("onboard", "groundstation", "sitl", "tests")
# A mutant that goes on for ever is noticed by that: its tests may take so long.
_LIMIT_AT_LEAST_S = 20.0
_LIMIT_BY_DURATION = 10.0
_NOTICED = "noticed"
_SURVIVES = "survives"
_NO_FUNCTION_TAKES_IT = "no function takes it"

Line = tuple[str, int]  # file and number
_Test = TypeVar("_Test")


class Mutant(NamedTuple):
    """One changed place of a file."""

    file: Path  # relative to the folder of the project
    line: int
    change: str
    first_line: int  # of the statement that holds the place
    last_line: int
    is_in_function: bool
    make_tree: Callable[[], ast.Module]  # of the changed file, with the lines of the file


class RoomFails(Exception):
    """A room's tests fail without any change, by which mutants would prove nothing."""


def verdicts(
    paths: Sequence[str],
    mutants: Sequence[Mutant],
    root: Path = ROOT,
    most_s: float = math.inf,
) -> Iterator[tuple[Mutant, bool]]:
    """Yield each mutant, and whether a test has noticed it, as soon as that is known.

    Args:
        paths: tests of the room, relative to the project.
        mutants: all of the same project.
        root: folder of the project.
        most_s: for the tests of one mutant; slower ones are left out.

    Raises:
        RoomFails: when a test fails without any change.
    """
    _import_libraries()
    with tempfile.TemporaryDirectory(prefix="covey-mutants-") as bytecode:
        sys.pycache_prefix = bytecode  # what is imported again is compiled once
        trials = _Trials(mutants, root, most_s)
        with _Fork(lambda send: trials.run(paths, send)) as session:
            sent: dict[str, tuple[float, frozenset[str]]] | None = session.message()
            if not sent:
                raise RoomFails("the room's tests could not be run")
            tests = {name: _Summary(*summary) for name, summary in sent.items()}
            failed = [name for name, test in tests.items() if test.duration_s < 0.0]
            if failed:
                raise RoomFails(f"without any change these fail: {', '.join(failed)}")

            left = set(range(len(mutants)))
            while (message := session.message()) is not None:
                index, verdict = message
                left.remove(index)
                yield mutants[index], verdict == _NOTICED

        for index in sorted(left):
            file = str(root / mutants[index].file)
            nearest_first = sorted(tests, key=lambda name: file not in tests[name].files)
            durations_s = {name: tests[name].duration_s for name in nearest_first}
            chosen_s = _first(durations_s, most_s)
            verdict = _verdict_when_imported(mutants[index], chosen_s, root)
            yield mutants[index], verdict == _NOTICED


class _TracedTest(NamedTuple):
    """What a test executes of the room."""

    item: pytest.Item
    duration_s: float  # negative when it failed, infinite when it was ended
    lines: frozenset[Line]


class _Summary(NamedTuple):
    """What is known of a test outside of its process."""

    duration_s: float  # negative when it failed
    files: frozenset[str]  # of the mutants, that it executes a line of


class _Trials:
    """A session of pytest that traces its tests and then tries the mutants inside functions."""

    def __init__(self, mutants: Sequence[Mutant], root: Path, most_s: float) -> None:
        self._mutants = mutants
        self._root = root
        self._most_s = most_s
        self._files = frozenset(str(root / mutant.file) for mutant in mutants)
        self._lines_of_imports: set[Line] = set()
        self._send: Callable[[object], None] = print

    def run(self, paths: Sequence[str], send: Callable[[object], None]) -> None:
        """Import and run the tests; send how long each took, then the index and the verdict of
        each mutant that could be tried.
        """
        self._send = send
        _prepare_process(self._root)
        sys.dont_write_bytecode = False
        sys.settrace(_tracer(self._files, self._lines_of_imports))
        _run_pytest(self._root, paths, plugin=self)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Do all work in the place of pytest's own loop."""
        sys.settrace(None)
        sys.dont_write_bytecode = True
        if session.testsfailed:  # to be imported
            return True

        tests = [self._trace(session, item) for item in session.items]
        tests.sort(key=lambda test: test.duration_s)
        quick = [test for test in tests if math.isfinite(test.duration_s)]
        summaries = {}  # no class of this module: it is imported once more in here
        for test in quick:
            files = frozenset(file for file, _ in test.lines)
            summaries[test.item.nodeid] = (test.duration_s, files)
        self._send(summaries)

        # looked up once: to look at all objects in each fork would copy all of the memory
        functions = _functions_of(self._files)
        gc.freeze()
        gc.disable()
        for index, mutant in enumerate(self._mutants):
            acts_at_imports = _executes(self._lines_of_imports, mutant, self._root)
            if acts_at_imports or not mutant.is_in_function:
                continue
            verdict = self._verdict(session, mutant, quick, functions)
            if verdict != _NO_FUNCTION_TAKES_IT:
                self._send((index, verdict))
        return True

    def _trace(self, session: pytest.Session, item: pytest.Item) -> _TracedTest:
        """Run a test in a fork, which leaves the caches of this process cold for the next.

        A test that alone takes longer than all tests of a mutant may is ended, and left out.
        """

        def run(send: Callable[[object], None]) -> None:
            lines: set[Line] = set()
            begin_s = time.process_time()  # of the processor, which others may use too
            sys.settrace(_tracer(self._files, lines))
            has_failed = _has_a_failure(session, [item])
            sys.settrace(None)
            duration_s = time.process_time() - begin_s
            send((-1.0 if has_failed else duration_s, frozenset(lines)))

        with _Fork(run) as fork:
            found = fork.message(None if math.isinf(self._most_s) else self._most_s)
        duration_s, lines = found or (math.inf, frozenset())
        return _TracedTest(item, duration_s, lines)

    def _verdict(
        self,
        session: pytest.Session,
        mutant: Mutant,
        tests: Sequence[_TracedTest],
        functions: Collection[FunctionType],
    ) -> str:
        durations_s = {
            test.item: test.duration_s
            for test in tests
            if _executes(test.lines, mutant, self._root)
        }
        chosen_s = _first(durations_s, self._most_s)
        if not chosen_s:
            return _SURVIVES

        def run(send: Callable[[object], None]) -> None:
            if not _put_into_functions(mutant, functions, self._root):
                send(_NO_FUNCTION_TAKES_IT)
            elif not _has_a_failure(session, list(chosen_s)):
                send(_SURVIVES)

        with _Fork(run) as fork:
            return fork.message(_limit_s(chosen_s.values())) or _NOTICED


def _verdict_when_imported(mutant: Mutant, durations_s: dict[str, float], root: Path) -> str:
    """Return the verdict of some tests about a mutant that acts while modules are imported."""
    files = dict.fromkeys(name.partition("::")[0] for name in durations_s)

    def run(send: Callable[[object], None]) -> None:
        _prepare_process(root)
        _import_changed(mutant, root)
        if _run_pytest(root, ["-x", *files], plugin=_OnlyThese(list(durations_s))) == 0:
            send(_SURVIVES)

    with _Fork(run) as fork:
        return fork.message(_limit_s(durations_s.values())) or _NOTICED


class _OnlyThese:
    """Chooses and orders the tests of a session of pytest."""

    def __init__(self, names: Sequence[str]) -> None:
        self._ranks = {name: rank for rank, name in enumerate(names)}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep the chosen tests, in their order."""
        items[:] = [item for item in items if item.nodeid in self._ranks]
        items.sort(key=lambda item: self._ranks[item.nodeid])


def _first(durations_s: Mapping[_Test, float], most_s: float) -> dict[_Test, float]:
    """Return as many of the first tests as take so long together, and one at least."""
    chosen: dict[_Test, float] = {}
    for test, duration_s in durations_s.items():
        if chosen and sum(chosen.values()) + duration_s > most_s:
            break
        chosen[test] = duration_s
    return chosen


def _executes(lines: Collection[Line], mutant: Mutant, root: Path) -> bool:
    """Return whether lines hold one of the statement that a mutant changes."""
    file = str(root / mutant.file)
    return any((file, line) in lines for line in range(mutant.first_line, mutant.last_line + 1))


def _limit_s(durations_s: Iterable[float]) -> float:
    """Return how long tests may take that took so long, traced, without a change."""
    return _LIMIT_AT_LEAST_S + _LIMIT_BY_DURATION * sum(durations_s)


def _tracer(files: frozenset[str], lines: set[Line]) -> Callable[[FrameType, str, Any], Any]:
    """Return a trace function that writes down which lines of some files are executed."""

    def note(frame: FrameType, event: str, _: object) -> Any:
        if event == "line":
            lines.add((frame.f_code.co_filename, frame.f_lineno))
        return note

    def choose(frame: FrameType, _: str, __: object) -> Any:
        if frame.f_code.co_filename in files:
            return note
        return None

    return choose


def _has_a_failure(session: pytest.Session, items: Sequence[pytest.Item]) -> bool:
    """Run tests up to the first that fails; return whether there is one."""
    for item, following in zip(items, [*items[1:], None], strict=True):
        session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if session.testsfailed:
            return True
    return False


def _functions_of(files: Collection[str]) -> list[FunctionType]:
    """Return all functions that some files have defined so far."""
    return [
        one
        for one in gc.get_objects()
        if type(one) is FunctionType and one.__code__.co_filename in files
    ]


def _put_into_functions(mutant: Mutant, functions: Collection[FunctionType], root: Path) -> bool:
    """Give the functions of a file their changed code; return False where Python refuses it,
    because a function would then use other variables of the one around it.
    """
    file = str(root / mutant.file)
    changed = compile(mutant.make_tree(), file, "exec", dont_inherit=True)
    code_at = {_place_of(code): code for code in _codes(changed)}
    for function in functions:
        if function.__code__.co_filename == file:
            try:
                function.__code__ = code_at[_place_of(function.__code__)]
            except (KeyError, ValueError):
                return False
    return True


def _place_of(code: CodeType) -> tuple[str, int, int]:
    """Return what tells the functions of a file apart; several lambdas may begin in one line."""
    first_column = 0
    if code.co_name == "<lambda>":
        first_column = min(column or 0 for _, _, column, _ in list(code.co_positions())[1:])
    return code.co_qualname, code.co_firstlineno, first_column


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Yield a code object and all inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _import_changed(mutant: Mutant, root: Path) -> None:
    """Make imports of this process find the changed code instead of the file's."""
    file = str(root / mutant.file)
    changed = compile(mutant.make_tree(), file, "exec", dont_inherit=True)
    get_code = SourceFileLoader.get_code

    def get_changed_code(self: SourceFileLoader, name: str) -> CodeType | None:
        if self.path == file:
            return changed
        return get_code(self, name)

    SourceFileLoader.get_code = get_changed_code  # type: ignore[method-assign, assignment]


def _prepare_process(root: Path) -> None:
    """Make this process ready to import the project's modules anew."""
    os.chdir(root)
    os.environ["COVEY_NUMBA"] = "0"
    sys.path.insert(0, str(root))
    for name in list(sys.modules):
        if name.partition(".")[0] in _OUR_PACKAGES:
            del sys.modules[name]


def _run_pytest(root: Path, words: Sequence[str], plugin: object) -> int:
    return int(pytest.main([*_PYTEST_WORDS, f"--rootdir={root}", *words], plugins=[plugin]))


def _import_libraries() -> None:
    """Import what every run needs."""
    for name in ("numpy", "numba", "hypothesis", "msgspec", "pytest_asyncio", "zenoh", "scipy"):
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


class _Fork:
    """A fork of this process that does some work without a word and sends its results."""

    def __init__(self, work: Callable[[Callable[[object], None]], None]) -> None:
        self._receiver, sender = multiprocessing.Pipe(duplex=False)
        self._child = os.fork()
        if self._child == 0:
            try:
                self._receiver.close()
                _be_silent()
                work(sender.send)
            finally:
                os._exit(0)
        sender.close()

    def message(self, limit_s: float | None = None) -> Any:
        """Return the next result; None when the process has ended or the time is over."""
        try:
            if not self._receiver.poll(limit_s):
                return None
            return self._receiver.recv()
        except EOFError:
            return None

    def __enter__(self) -> _Fork:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self._child, signal.SIGKILL)
        os.waitpid(self._child, 0)
        self._receiver.close()


def _be_silent() -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
