"""How many calls one flying tick of an agent makes inside ``onboard``, and how often it goes from
one module to another.

    make bench-moves ARGS="--path"

Three vehicles fly in lockstep. Between two ticks the agent of one of them is copied, and the copy
takes one more tick with what the original receives. It is watched while it does.

An agent on a drone interprets its pipeline, the avoidance law included; so it does here, and each
call of the law counts like any other. Compiled code flies only where several agents share a process
(lockstep, ``covey simulate``). How much of the tick the law is stands in a line of its own.

Whoever reads a tick follows it from module to module. A *move* is a call into another module than
that of the call before it: each of them is a page that has to be turned. Calls inside a module,
returns, and code outside of ``onboard`` do not count, and neither does ``onboard/vectors.py``: its
sums and products are read like operators.
"""

from __future__ import annotations

import argparse
import copy
import functools
import itertools
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import NamedTuple

from onboard.agent.core import AgentCore
from onboard.agent_commands import Command
from onboard.agent_inputs import AgentInput
from onboard.config.fleet import load_fleet
from sitl.lockstep.flight import Lockstep

ROOT = Path(__file__).parents[2]
ONBOARD = ROOT / "onboard"
ARITHMETIC = "vectors"
LAW = "avoidance"  # its room
VEHICLE = "mav1"
FLOWN_S = 2.0  # of the crossing, before the first tick that is watched
WATCHED_TICKS = 50  # so that the slow checks, which come every fifth tick, have their share
TICK_S = 0.02


class TickMoves(NamedTuple):
    """What one tick has done."""

    calls: int
    moves: int  # calls into another module than that of the call before
    modules: int
    rooms: tuple[str, ...]  # in the order in which the tick went through them


def watched(function: Callable[[], object]) -> list[str]:
    """Return the module of each call inside ``onboard`` that a function makes, in their order."""
    modules: list[str] = []
    prefix = f"{ONBOARD}/"

    def look(frame: FrameType, event: str, _: object) -> None:
        if event != "call":
            return
        code = frame.f_code
        is_comprehension = code.co_name.startswith("<") and code.co_name != "<lambda>"
        if not code.co_filename.startswith(prefix) or is_comprehension:
            return
        module = code.co_filename.removeprefix(prefix).removesuffix(".py")
        if module != ARITHMETIC:
            modules.append(module)

    sys.setprofile(look)
    try:
        function()
    finally:
        sys.setprofile(None)
    return modules


def measured(modules: Sequence[str]) -> TickMoves:
    """Return the figures of a tick from the modules of its calls."""
    moves = sum(1 for before, after in itertools.pairwise(modules) if before != after)
    rooms = [module.partition("/")[0] for module in modules]
    return TickMoves(
        calls=len(modules),
        moves=moves,
        modules=len(set(modules)),
        rooms=tuple(room for room, _ in itertools.groupby(rooms)),
    )


def flying_ticks() -> list[list[str]]:
    """Fly three vehicles towards each other; the modules of the calls of each watched tick."""
    fleet = load_fleet(ROOT / "configs/fleets/paper.toml")
    ticks = []
    with Lockstep(fleet, seed=1, is_compiled=False) as flight:
        flight.ready()
        flight.takeoff(1.0)
        flight.order("formation triangle", timeout_s=FLOWN_S)
        shell = flight.agents[VEHICLE]

        for _ in range(WATCHED_TICKS):
            before = copy.deepcopy(shell.core)
            events = recorded_tick(flight, shell.core)
            now_ns = flight.bus.now_ns()
            for event, received_ns in events:
                before.handle(event, received_ns)
            ticks.append(watched(functools.partial(before.tick, now_ns)))
    return ticks


def recorded_tick(flight: Lockstep, core: AgentCore) -> list[tuple[AgentInput, int]]:
    """Let the flight go on for one tick; what the agent was given in it, and when."""
    events: list[tuple[AgentInput, int]] = []
    handle = core.handle

    def recording(agent_input: AgentInput, now_ns: int) -> list[Command]:
        events.append((agent_input, now_ns))
        return handle(agent_input, now_ns)

    core.handle = recording  # type: ignore[method-assign]
    flight.run(TICK_S)
    del core.handle
    return events


def main(argv: Sequence[str] | None = None) -> int:
    """Print calls, moves and modules of a tick: the median and the largest of some."""
    parser = argparse.ArgumentParser(
        prog="make bench-moves",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--path", action="store_true", help="also the modules of a median tick")
    options = parser.parse_args(argv)

    ticks = sorted(flying_ticks(), key=lambda modules: measured(modules).moves)
    median = ticks[len(ticks) // 2]
    for name, modules in (("median", median), ("largest", ticks[-1])):
        tick = measured(modules)
        print(f"{name}: {tick.calls} calls, {tick.moves} moves between {tick.modules} modules")

    beside_law = [module for module in median if module.partition("/")[0] != LAW]
    beside = measured(beside_law)
    print(
        f"the median tick beside the interpreted law: {beside.calls} calls, {beside.moves} moves "
        f"between {beside.modules} modules"
    )

    back_and_forth = Counter(itertools.pairwise(measured(median).rooms))
    print("from room to room, median tick:")
    for (before, after), count in back_and_forth.most_common(8):
        print(f"  {before} > {after}: {count}")
    if options.path:
        for module, calls in itertools.groupby(median):
            print(f"{sum(1 for _ in calls):4d} {module}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
