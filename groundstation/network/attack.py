"""An attack on an emulated copy of a fleet (``covey check attack``), and the report about it.

Every attempt is made twice: on a copy without keys, where it has to get in, and on a copy with
keys, where it has to be stopped. An attempt that is stopped in both cases proves nothing about the
keys. Both copies fly meanwhile, and the one with keys has to keep its distances and its timing.
"""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from groundstation.network.attempts import AttackContext, NoProofError, attempts, spare_vehicle
from groundstation.network.fleet_copy import CopyFlight, copied_names, copy_of, flying
from groundstation.network.intruder import Intruders
from groundstation.processes.supervisor import ProcessError
from onboard.config.fleet import ConfigError, FleetConfig

_LATE_MS = 25.0  # a loop with a larger p99 of its period is late; the nominal period is 20 ms
_WORDS = {True: "GOT IN", False: "stopped"}

# Whether an attempt got in; or a sentence that says why the attempt proves nothing.
Outcome = bool | str
Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class AttemptResult:
    """The result of one attempt."""

    name: str
    # Whether it got in on the copy with keys, and on the one without. None: it was not made there,
    # or it proves nothing.
    with_keys: bool | None
    without_keys: bool | None
    is_right: bool  # whether the keys stopped it, and nothing else
    remark: str = ""  # why the attempt proves nothing; empty if it proves something


@dataclass(frozen=True, slots=True)
class FlightFigures:
    """Figures of the flight of the copy with keys, while it was attacked."""

    separation_m: float  # smallest distance of two vehicles
    safety_distance_m: float
    loop_p99_ms: float  # p99 of the period of the slowest control loop
    neighbour_age_ms: float  # greatest age of a neighbour's state
    is_right: bool  # whether distances and timing were kept


@dataclass(frozen=True, slots=True)
class AttackReport:
    """The results of all attempts, and the figures of the flight during the attack."""

    results: list[AttemptResult]
    figures: FlightFigures

    @property
    def is_right(self) -> bool:
        """Whether no attempt got in, each proves something, and the fleet flew as it should."""
        return all(result.is_right for result in self.results) and self.figures.is_right

    def as_mapping(self) -> dict[str, object]:
        """Return the report for programs."""
        return {"tries": [asdict(result) for result in self.results], **asdict(self.figures)}

    def as_text(self) -> str:
        """Return the report for people."""
        lines = ["", f"{'with keys':10s} {'without':10s} try"]
        for result in self.results:
            with_keys = _column(result.with_keys)
            without_keys = _column(result.without_keys)
            remark = f": {result.remark}" if result.remark else ""
            lines.append(f"{with_keys} {without_keys} {result.name}{remark}")

        stopped = sum(1 for result in self.results if result.is_right)
        lines.append(f"\n{stopped} of {len(self.results)} tries were stopped.")

        figures = self.figures
        lines.append(
            f"Meanwhile the fleet with keys flew: smallest distance {figures.separation_m} m "
            f"(safety distance {figures.safety_distance_m} m), "
            f"loops' period {figures.loop_p99_ms} ms (p99), "
            f"oldest state of a neighbour {figures.neighbour_age_ms} ms."
        )
        return "\n".join(lines)


def _column(value: bool | None) -> str:
    word = "-" if value is None else _WORDS[value]
    return f"{word:10s}"


def attack_copies(fleet: FleetConfig, *, is_long: bool, only: str = "", say: Say) -> AttackReport:
    """Attack a copy of a fleet without keys and one with keys, while they fly.

    Args:
        fleet: the fleet that is copied; its own running processes are not touched.
        is_long: whether floods and bad frames last minutes instead of seconds.
        only: only attempts whose name contains this are made; empty: all.
        say: called with each line of progress.

    Raises:
        ConfigError: the fleet has too few vehicles, its copy does not fly, or no attempt has such a
            name.
    """
    if len(fleet.enabled_names) < 2:
        raise ConfigError(
            f"{fleet.path}: an attack needs two vehicles, one of which loses its key."
            " Enable another."
        )
    attempt_names = [attempt.name for attempt in attempts(copied_names(fleet))]
    if not any(only in name for name in attempt_names):
        listed = "\n  ".join(attempt_names)
        raise ConfigError(f"No try has '{only}' in its name. There are:\n  {listed}")

    if not fleet.has_keys:
        say(
            f"{fleet.path} itself has no keys: whoever reaches its bus gets in."
            f" Lock it: covey keys secure {fleet.path}"
        )

    with tempfile.TemporaryDirectory(prefix="covey-attack-") as folder:
        try:
            return asyncio.run(
                _attack_both(fleet, Path(folder), is_long=is_long, only=only, say=say)
            )
        except ProcessError as error:
            raise ConfigError(f"The copy of the fleet does not fly: {error}") from None


async def _attack_both(
    fleet: FleetConfig, folder: Path, *, is_long: bool, only: str, say: Say
) -> AttackReport:
    """Make the attempts on a flying copy without keys, then on one with keys, and compare."""
    open_copy = copy_of(fleet, folder / "open", is_locked=False)
    say(f"\nA copy of {len(open_copy.enabled_names)} vehicles without keys takes off.")
    async with flying(open_copy) as flight:
        without_keys = await _attempt_all(flight, folder, is_long=is_long, only=only, say=say)

    locked_copy = copy_of(fleet, folder / "locked", is_locked=True)
    say(f"\nA copy of {len(locked_copy.enabled_names)} vehicles with keys takes off.")
    async with flying(locked_copy) as flight:
        with_keys = await _attempt_all(flight, folder, is_long=is_long, only=only, say=say)
        flight.measure()
        figures = _figures(flight)

    results = [
        _result(name, outcome, without_keys.get(name)) for name, outcome in with_keys.items()
    ]
    return AttackReport(results, figures)


async def _attempt_all(
    flight: CopyFlight, folder: Path, *, is_long: bool, only: str, say: Say
) -> dict[str, Outcome]:
    """Make all attempts on one copy; return their outcomes by name."""
    context = AttackContext(flight, Intruders(flight.fleet, folder), is_long)
    outcomes: dict[str, Outcome] = {}

    # Attempts block, so each runs in a thread: the event loop is free for the flight's client.
    # The node of the spare vehicle, which never flies, notes what reaches it from the attempts.
    spare_node = await asyncio.to_thread(spare_vehicle, context)
    try:
        for attempt in attempts(flight.names):
            if only not in attempt.name:
                continue
            if attempt.is_stopped_without_keys and not context.has_keys:
                continue
            try:
                got_in = await asyncio.to_thread(attempt.gets_in, context)
            except NoProofError as error:
                outcomes[attempt.name] = str(error)
                say(f"  NO PROOF  {attempt.name}")
            else:
                outcomes[attempt.name] = got_in
                say(f"  {_WORDS[got_in]}  {attempt.name}")
    finally:
        await asyncio.to_thread(spare_node.stop)
    return outcomes


def _result(name: str, with_keys: Outcome, without_keys: Outcome | None) -> AttemptResult:
    """Return the result of an attempt from its outcomes on both copies.

    Args:
        name: name of the attempt.
        with_keys: its outcome on the copy with keys.
        without_keys: its outcome on the copy without keys; None if it was not made there, because
            something other than keys stops it.
    """
    remark = ""
    if without_keys is False:
        remark = "it does not get in without keys either: this try proves nothing"
    elif isinstance(with_keys, str):
        remark = with_keys
    elif isinstance(without_keys, str):
        remark = without_keys

    # without an attempt on the copy without keys, something other than keys stops it
    is_proof = without_keys is None or without_keys is True
    return AttemptResult(
        name=name,
        with_keys=with_keys if isinstance(with_keys, bool) else None,
        without_keys=without_keys if isinstance(without_keys, bool) else None,
        is_right=with_keys is False and is_proof,
        remark=remark,
    )


def _figures(flight: CopyFlight) -> FlightFigures:
    safety_distance_m = flight.fleet.fleet.safety_distance_m
    loop_ms = max(flight.worst_loop_ms.values(), default=0.0)
    is_apart = flight.separation_m >= safety_distance_m
    is_in_time = loop_ms <= _LATE_MS
    return FlightFigures(
        separation_m=round(flight.separation_m, 3),
        safety_distance_m=safety_distance_m,
        loop_p99_ms=round(loop_ms, 1),
        neighbour_age_ms=round(flight.worst_age_ms, 1),
        is_right=is_apart and is_in_time,
    )
