"""Parameters of each vehicle's PX4 beside those that close flight needs; setting them, and reading them back.

The vehicle's own link is used when no agent holds it, else PX4's ground link (``direct``): PX4 answers on a link only
the program that it heard there first, so nothing may push in between an agent and its autopilot.
"""

from __future__ import annotations

import multiprocessing
import textwrap
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from groundstation.client.direct_mavlink import DirectParams
from onboard.autopilot import LinkError, Version
from onboard.config.fleet import Vehicle
from onboard.exit_status import EXIT_FAILED, EXIT_MIXED, EXIT_NO_ANSWER, EXIT_OK
from onboard.px4.mavsdk_link import Px4Link
from onboard.px4.required_params import RequiredParam, all_params

_ANSWER_S, _VERSION_S = 4.0, 1.0
_STORE_S, _SECOND_WRITE_S = 5.0, 0.5
_ACCEPTED = 0
_WIDTH = 118
_LARGEST_BATCH = 8
Result = TypeVar("Result")


class ParamsLink(Protocol):
    """Connection to PX4's parameters."""

    def stop(self) -> None: ...
    def is_armed(self, timeout_s: float) -> bool | None: ...
    def version(self, timeout_s: float) -> Version | None: ...
    def read_params(self, names: Mapping[str, float | int]) -> dict[str, float | int | None]: ...
    def apply_params(self, values: Mapping[str, float | int]) -> None: ...
    def request_storage(self, timeout_s: float) -> int | None: ...


class _LinkParams(Px4Link):
    """The agent's own link, taken over from here while no agent runs."""

    def __init__(self, endpoint: str, system_id: int) -> None:
        super().__init__(endpoint, system_id)
        self.start()

    def is_armed(self, timeout_s: float) -> bool | None:
        """Return whether the first heartbeat says armed; None without a heartbeat."""
        end_s = time.monotonic() + timeout_s
        if not self.connect(timeout_s):
            return None
        while time.monotonic() < end_s:
            if self.snapshot().heartbeat_ns:
                return self.snapshot().is_armed
            time.sleep(0.02)
        return None

    def version(self, timeout_s: float) -> Version | None:
        """Return major and minor number of PX4's version; None when it does not say it in time."""
        end_s = time.monotonic() + timeout_s
        while self.snapshot().px4_version is None and time.monotonic() < end_s:
            time.sleep(0.02)
        return self.snapshot().px4_version


@dataclass(frozen=True, slots=True)
class ParameterState:
    """One parameter of one vehicle."""

    demand: RequiredParam
    value: float | int | None  # None: PX4 did not send it
    before: float | int | None = None  # another value, until it was set here

    @property
    def is_met(self) -> bool:
        """Whether it is as it should be."""
        return self.demand.is_met(self.value)

    @property
    def was_set(self) -> bool:
        """Whether it was set, and read back."""
        return self.before is not None and self.is_met


@dataclass(frozen=True, slots=True)
class VehicleParams:
    """Parameters of one vehicle, read at one endpoint; ``trouble``: why there are no more."""

    name: str
    endpoint: str
    rows: tuple[ParameterState, ...]
    trouble: str = ""
    is_stored: bool = False  # PX4 has written them: a restart keeps them

    @property
    def answers(self) -> bool:
        """Whether PX4 sent any value."""
        return any(row.value is not None for row in self.rows)

    @property
    def is_fine(self) -> bool:
        """Whether everything is met that take-off is refused without."""
        return not self.trouble and all(row.is_met or row.demand.is_advice for row in self.rows)

    @property
    def restarts_for(self) -> tuple[str, ...]:
        """Parameters that were set and that PX4 reads only when it starts."""
        return tuple(row.demand.name for row in self.rows if row.was_set and row.demand.needs_restart)


def read_or_set_all(vehicles: Sequence[Vehicle], *, applies: bool) -> list[VehicleParams]:
    """Do for each what :func:`read_or_set` does for one, several at a time."""
    if len(vehicles) == 1:
        return [read_or_set(vehicles[0], applies=applies)]
    crashed = "The reading crashed twice, perhaps after a parameter was set: run it again."
    with ThreadPoolExecutor(_LARGEST_BATCH) as pool:
        found = pool.map(lambda vehicle: in_own_process(read_or_set, vehicle, applies=applies), vehicles)
        return [state or _without_answer(vehicle, crashed) for state, vehicle in zip(found, vehicles, strict=True)]


def in_own_process(function: Callable[..., Result], *args: Any, **kwargs: Any) -> Result | None:
    """Call a function in a process of its own, and once more when that crashes; None when it crashes again.

    Several links in one process crash MAVSDK 4.1 now and then.
    """
    for _ in range(2):
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool, suppress(BrokenProcessPool):
            return pool.submit(function, *args, **kwargs).result()
    return None


def read_or_set(vehicle: Vehicle, *, applies: bool) -> VehicleParams:
    """Read one vehicle's parameters at the endpoint that answers; ``applies``: set those that differ."""
    troubles: list[str] = []
    links: list[tuple[str, type[Any]]] = [(vehicle.autopilot, _LinkParams)]
    if vehicle.direct is not None:
        links.append((vehicle.direct, DirectParams))
    for endpoint, kind in links:
        try:
            link: ParamsLink = kind(endpoint, vehicle.system_id)
        except (LinkError, OSError, ValueError) as error:
            troubles.append(str(error))
            continue
        try:
            is_armed = link.is_armed(_ANSWER_S)
            if is_armed is not None:
                return _by(link, vehicle, endpoint, is_armed, applies)
            troubles.append(f"Nothing is heard from PX4 at {endpoint}.")
        except LinkError as error:
            troubles.append(str(error))
        finally:
            link.stop()
    if vehicle.direct is None:
        troubles.append(
            f"The fleet file gives no direct endpoint: stop its agent, or set vehicles.{vehicle.name}.direct to PX4's "
            "ground link."
        )
    else:
        troubles.append("Start PX4, or check cable and ports.")
    return _without_answer(vehicle, " ".join(troubles))


def _without_answer(vehicle: Vehicle, trouble: str) -> VehicleParams:
    return VehicleParams(
        vehicle.name, "", tuple(ParameterState(demand, None) for demand in all_params(vehicle)), trouble
    )


def _by(link: ParamsLink, vehicle: Vehicle, endpoint: str, is_armed: bool, applies: bool) -> VehicleParams:
    wanted = all_params(vehicle, link.version(_VERSION_S))
    values = link.read_params({demand.name: demand.value for demand in wanted})
    wrong = {demand.name: demand.value for demand in wanted if not demand.is_met(values[demand.name])}
    rows = tuple(ParameterState(demand, values[demand.name]) for demand in wanted)
    if not applies or (is_armed and not wrong):
        return VehicleParams(vehicle.name, endpoint, rows)
    if is_armed:
        return VehicleParams(
            vehicle.name, endpoint, rows, "It is armed, and parameters are set on the ground only: land and disarm it."
        )
    link.apply_params({name: value for name, value in wrong.items() if values[name] is not None})
    is_stored = store(link.request_storage, _STORE_S)
    again = link.read_params(wrong)
    rows = tuple(
        ParameterState(
            demand, again.get(demand.name, values[demand.name]), values[demand.name] if demand.name in wrong else None
        )
        for demand in wanted
    )
    failed = [row.demand.name for row in rows if row.before is not None and not row.was_set]
    troubles = [f"PX4 did not take {', '.join(failed)}."] if failed else []
    if not is_stored:
        troubles.append(
            "PX4 did not confirm that it stored them: a restart may lose them. Run this once more before a restart."
        )
    return VehicleParams(vehicle.name, endpoint, rows, " ".join(troubles), is_stored)


def store(
    request: Callable[[float], int | None], timeout_s: float, sleep: Callable[[float], None] = time.sleep
) -> bool:
    """Have PX4 write its parameters, and wait until it has; False when that was not confirmed in time.

    PX4 writes changed parameters by itself up to 3.5 s later, and a restart before that loses them. PREFLIGHT_STORAGE
    writes at once, but is accepted before the writing. While PX4 writes it rejects another one: so the next acceptance
    shows that the first writing has ended. The second has nothing new to write.
    """
    end_s = time.monotonic() + timeout_s
    accepted = 0
    while accepted < 2 and time.monotonic() < end_s:
        accepted += request(0.5) == _ACCEPTED
        sleep(0.1)
    if accepted == 2:
        sleep(_SECOND_WRITE_S)
    return accepted == 2


def exit_status(answers: Sequence[VehicleParams]) -> int:
    """0 all are as needed; 1 none is; 10 nobody answered; 50 some are and some are not."""
    if not any(answer.answers for answer in answers):
        return EXIT_NO_ANSWER
    fine = [answer.is_fine for answer in answers]
    return EXIT_OK if all(fine) else EXIT_MIXED if any(fine) else EXIT_FAILED


def as_text(answers: Sequence[VehicleParams]) -> str:
    """The list for people."""
    lines: list[str] = []
    for answer in answers:
        off = sum(not row.is_met for row in answer.rows)
        if not answer.answers:
            lines += textwrap.wrap(f"{answer.name}: no answer. {answer.trouble}", _WIDTH, subsequent_indent="  ")
            continue
        state = f"{off} of {len(answer.rows)} differ" if off else f"all {len(answer.rows)} are as they should be"
        lines.append(f"{answer.name}, read at {answer.endpoint}: {state}.")
        for row in answer.rows:
            lines += textwrap.wrap(_line(row), _WIDTH, subsequent_indent=" " * 10, initial_indent="  ")
        if answer.trouble:
            lines.append(f"  {answer.trouble}")
        if answer.is_stored:
            lines.append("  Stored: PX4 keeps them over a restart.")
        if answer.restarts_for:
            lines.append(f"  Restart PX4: it reads {', '.join(answer.restarts_for)} only when it starts.")
    return "\n".join(lines)


def _line(row: ParameterState) -> str:
    demand = row.demand
    value = "not sent" if row.value is None else f"{row.value:g}"
    if row.was_set:
        return f"{'set':<8}{demand.name:<16} {row.before:g} -> {value}, read back: {demand.reason}"
    if row.is_met:
        return f"{'ok':<8}{demand.name:<16} {value}"
    mark = "better" if demand.is_advice else "WRONG"
    return f"{mark:<8}{demand.name:<16} {value}, should be {demand.value:g}: {demand.reason}"


def as_mapping(answers: Sequence[VehicleParams]) -> dict[str, Any]:
    """The same for programs."""
    return {
        answer.name: {
            "answers": answer.answers,
            "is_fine": answer.is_fine,
            "asked_at": answer.endpoint,
            "trouble": answer.trouble,
            "is_stored": answer.is_stored,
            "restart_for": list(answer.restarts_for),
            "params": {
                row.demand.name: {
                    "is": row.value,
                    "should": row.demand.value,
                    "why": row.demand.reason,
                    "is_met": row.is_met,
                    "is_required": not row.demand.is_advice,
                    "was_set": row.was_set,
                }
                for row in answer.rows
            },
        }
        for answer in answers
    }
