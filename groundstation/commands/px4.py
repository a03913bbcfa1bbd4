"""``covey px4 params``: what each vehicle's PX4 is set to, what close flight needs and why; and setting it.

The vehicle's own link is asked when no agent holds it, else PX4's ground link (``direct``): PX4 answers on a link only
to whom it heard there first, so nobody may push in between an agent and its autopilot.
"""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol

from groundstation.client.direct_mavlink import DirectParams
from onboard.autopilot import LinkError
from onboard.config.fleet import ConfigError, Vehicle, load_fleet
from onboard.px4.mavsdk_link import Px4Link
from onboard.px4.required_params import Demand, demands

EXIT_OK, EXIT_DIFFERS, EXIT_WRONG_INPUT, EXIT_NOBODY, EXIT_MIXED = 0, 1, 2, 10, 50
_ANSWER_S = 4.0
_AT_ONCE = 8
_WIDTH = 118


class Way(Protocol):
    """A way to PX4's parameters."""

    def stop(self) -> None: ...
    def is_armed(self, timeout_s: float) -> bool | None: ...
    def read_params(self, names: Mapping[str, float | int]) -> dict[str, float | int | None]: ...
    def apply_params(self, values: Mapping[str, float | int]) -> None: ...


class _LinkParams:
    """The agent's own link, taken over from here while no agent runs."""

    def __init__(self, endpoint: str, system_id: int) -> None:
        self._link = Px4Link(endpoint, system_id)
        self._link.start()
        self.read_params, self.apply_params, self.stop = (
            self._link.read_params,
            self._link.apply_params,
            self._link.stop,
        )

    def is_armed(self, timeout_s: float) -> bool | None:
        """What the first heartbeat says; None when nobody spoke."""
        end_s = time.monotonic() + timeout_s
        if not self._link.connect(timeout_s):
            return None
        while time.monotonic() < end_s:
            if self._link.snapshot().heartbeat_ns:
                return self._link.snapshot().is_armed
            time.sleep(0.02)
        return None


@dataclass(frozen=True, slots=True)
class Row:
    """One parameter: what it is (None: not told) and should be; ``before``: another value until it was set here."""

    demand: Demand
    value: float | int | None
    before: float | int | None = None

    @property
    def is_met(self) -> bool:
        """Whether it is as it should be."""
        return self.demand.is_met(self.value)

    @property
    def was_set(self) -> bool:
        """Whether it was set, and read back."""
        return self.before is not None and self.is_met


@dataclass(frozen=True, slots=True)
class Answer:
    """One vehicle: by which way, its rows, and why there is no more."""

    name: str
    way: str
    rows: tuple[Row, ...]
    trouble: str = ""

    @property
    def answers(self) -> bool:
        """Whether PX4 told anything."""
        return any(row.value is not None for row in self.rows)

    @property
    def is_fine(self) -> bool:
        """Whether everything is met that take-off is refused without."""
        return not self.trouble and all(row.is_met or row.demand.is_advice for row in self.rows)

    @property
    def restarts_for(self) -> tuple[str, ...]:
        """Parameters that were set and that PX4 reads only when it starts."""
        return tuple(row.demand.name for row in self.rows if row.was_set and row.demand.needs_restart)


def ask(vehicle: Vehicle, *, applies: bool) -> Answer:
    """Read one vehicle's parameters, by whichever way answers; with ``applies`` set what differs, and read back."""
    troubles: list[str] = []
    ways: list[tuple[str, type[Any]]] = [(vehicle.autopilot, _LinkParams)]
    if vehicle.direct is not None:
        ways.append((vehicle.direct, DirectParams))
    for endpoint, kind in ways:
        try:
            way: Way = kind(endpoint, vehicle.system_id)
        except (LinkError, OSError, ValueError) as error:
            troubles.append(str(error))
            continue
        try:
            is_armed = way.is_armed(_ANSWER_S)
            if is_armed is not None:
                return _by(way, vehicle, endpoint, is_armed, applies)
            troubles.append(f"Nothing is heard from PX4 at {endpoint}.")
        except LinkError as error:
            troubles.append(str(error))
        finally:
            way.stop()
    if vehicle.direct is None:
        troubles.append(
            f"The fleet file gives no second way: stop its agent, or set vehicles.{vehicle.name}.direct to PX4's "
            "ground link."
        )
    else:
        troubles.append("Start PX4, or check cable and ports.")
    return Answer(vehicle.name, "", tuple(Row(demand, None) for demand in demands(vehicle)), " ".join(troubles))


def _by(way: Way, vehicle: Vehicle, endpoint: str, is_armed: bool, applies: bool) -> Answer:
    wanted = demands(vehicle)
    values = way.read_params({demand.name: demand.value for demand in wanted})
    wrong = {demand.name: demand.value for demand in wanted if not demand.is_met(values[demand.name])}
    rows = tuple(Row(demand, values[demand.name]) for demand in wanted)
    if not applies or not wrong:
        return Answer(vehicle.name, endpoint, rows)
    if is_armed:
        return Answer(
            vehicle.name, endpoint, rows, "It is armed, and parameters are set on the ground only: land and disarm it."
        )
    way.apply_params({name: value for name, value in wrong.items() if values[name] is not None})
    again = way.read_params(wrong)
    rows = tuple(
        Row(demand, again.get(demand.name, values[demand.name]), values[demand.name] if demand.name in wrong else None)
        for demand in wanted
    )
    failed = [row.demand.name for row in rows if row.before is not None and not row.was_set]
    return Answer(vehicle.name, endpoint, rows, f"PX4 did not take {', '.join(failed)}." if failed else "")


def exit_status(answers: Sequence[Answer]) -> int:
    """0 all are as needed; 1 none is; 10 nobody answered; 50 some are and some are not."""
    if not any(answer.answers for answer in answers):
        return EXIT_NOBODY
    fine = [answer.is_fine for answer in answers]
    return EXIT_OK if all(fine) else EXIT_MIXED if any(fine) else EXIT_DIFFERS


def as_text(answers: Sequence[Answer]) -> str:
    """The list for people."""
    lines: list[str] = []
    for answer in answers:
        off = sum(not row.is_met for row in answer.rows)
        if not answer.answers:
            lines += textwrap.wrap(f"{answer.name}: no answer. {answer.trouble}", _WIDTH, subsequent_indent="  ")
            continue
        state = f"{off} of {len(answer.rows)} differ" if off else f"all {len(answer.rows)} are as they should be"
        lines.append(f"{answer.name}, asked at {answer.way}: {state}.")
        for row in answer.rows:
            lines += textwrap.wrap(_line(row), _WIDTH, subsequent_indent=" " * 10, initial_indent="  ")
        if answer.trouble:
            lines.append(f"  {answer.trouble}")
        if answer.restarts_for:
            lines.append(f"  Restart PX4: it reads {', '.join(answer.restarts_for)} only when it starts.")
    return "\n".join(lines)


def _line(row: Row) -> str:
    demand = row.demand
    told = "not told" if row.value is None else f"{row.value:g}"
    if row.was_set:
        return f"{'set':<8}{demand.name:<16} {row.before:g} -> {told}, read back: {demand.why}"
    if row.is_met:
        return f"{'ok':<8}{demand.name:<16} {told}"
    mark = "better" if demand.is_advice else "WRONG"
    return f"{mark:<8}{demand.name:<16} {told}, should be {demand.value:g}: {demand.why}"


def as_mapping(answers: Sequence[Answer]) -> dict[str, Any]:
    """The same for programs."""
    return {
        answer.name: {
            "answers": answer.answers,
            "is_fine": answer.is_fine,
            "asked_at": answer.way,
            "trouble": answer.trouble,
            "restart_for": list(answer.restarts_for),
            "params": {
                row.demand.name: {
                    "is": row.value,
                    "should": row.demand.value,
                    "why": row.demand.why,
                    "is_met": row.is_met,
                    "is_required": not row.demand.is_advice,
                    "was_set": row.was_set,
                }
                for row in answer.rows
            },
        }
        for answer in answers
    }


def main(argv: Sequence[str] | None = None) -> int:
    """``covey px4 params``; the exit status."""
    parser = argparse.ArgumentParser(prog="covey px4", description="PX4 itself, past the agents.")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    params = commands.add_parser(
        "params",
        help="parameters that this fleet needs: what they are and should be, and why",
        description="Read from every PX4 the parameters that this fleet needs; with --apply set what differs.",
        epilog="Exit status: 0 all are as needed; 1 none is; 2 wrong input; 10 nobody answered; 50 some are.",
    )
    params.add_argument("--fleet", metavar="FILE", required=True, help="fleet file")
    params.add_argument("--vehicles", metavar="NAMES", help="only these: names or places, a,b or 0-2 (default all)")
    params.add_argument("--exclude", metavar="NAMES", help="all but these")
    params.add_argument(
        "--apply", action="store_true", help="set what differs and read it back; disarmed vehicles only"
    )
    params.add_argument("--json", action="store_true", help="one object instead of the list")
    options = parser.parse_args(argv)
    try:
        fleet = load_fleet(options.fleet)
        names = fleet.select(options.vehicles, options.exclude)
        if not names:
            raise ConfigError("No vehicle is selected. Set enabled = true for one, or change --vehicles and --exclude.")
    except ConfigError as error:
        print(f"covey: {error}", file=sys.stderr)
        return EXIT_WRONG_INPUT
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        answers = list(pool.map(lambda name: ask(fleet.vehicles[name], applies=options.apply), names))
    print(json.dumps(as_mapping(answers), indent=2) if options.json else as_text(answers))
    return exit_status(answers)


if __name__ == "__main__":
    raise SystemExit(main())
