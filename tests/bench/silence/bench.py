"""``make bench-silence``: how soon the wire to PX4 is silent when an agent hangs, and what becomes
of the vehicle.

Real processes: the emulator, an agent for each way to hang, and between them the listener of
``wire.py``. All hover; one after the other is stopped, killed or blocked; the listener's stamps say
when the last setpoint passed, and PX4's heartbeats what became of the vehicle. Nothing here asks an
agent how it feels.
"""

from __future__ import annotations

import argparse
import asyncio
import copy
import itertools
import json
import os
import secrets
import signal
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from groundstation.missions.api import NotReady, OrderFailed
from groundstation.processes.free_ports import with_free_ports
from groundstation.processes.supervisor import ProcessError
from onboard.config.fleet import fleet_from_mapping
from onboard.security.mavlink_key import KEY_BYTES, key_file
from tests.bench.fixture import BenchFleet, fleet_data
from tests.bench.silence import wire

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_WRONG_INPUT = 2
LIMIT_S = 0.100
PX4_WAITS_S = 0.3  # COM_OF_LOSS_T
WIRE = "wire"
SPACING_M = 3.0
_DOWN_S = 40.0


@dataclass(frozen=True, slots=True)
class Case:
    """One way to hang.

    part: of ``agent.py``; "" for a signal that stops the whole process. limit_s: until the wire
    must be silent; None: setpoints must go on without a gap that PX4 takes for a loss. hang_s: how
    long it hangs; 0 for ever. lands: where setpoints go on, whether the agent must land by them.
    """

    name: str
    words: str
    part: str
    number: signal.Signals
    hang_s: float
    limit_s: float | None = LIMIT_S
    lands: bool = False


CASES = (
    Case(
        name="stopped",
        words="SIGSTOP, SIGCONT after 2 s",
        part="nothing",
        number=signal.SIGSTOP,
        hang_s=2.0,
    ),
    Case(
        name="stopped-briefly",
        words="SIGSTOP, SIGCONT after 0.5 s",
        part="nothing",
        number=signal.SIGSTOP,
        hang_s=0.5,
    ),
    Case(name="killed", words="SIGKILL", part="nothing", number=signal.SIGKILL, hang_s=0.0),
    Case(
        name="loop",
        words="event loop blocked for 2 s",
        part="loop",
        number=signal.SIGUSR1,
        hang_s=2.0,
    ),
    Case(
        name="loop-briefly",
        words="event loop blocked for 0.5 s",
        part="loop",
        number=signal.SIGUSR1,
        hang_s=0.5,
    ),
    Case(
        name="interpreter",
        words="a thread keeps Python's lock for 2 s",
        part="interpreter",
        number=signal.SIGUSR1,
        hang_s=2.0,
    ),
    Case(
        name="autopilot",
        words="MAVSDK's thread blocked for 2 s",
        part="autopilot",
        number=signal.SIGUSR1,
        hang_s=2.0,
    ),
    Case(
        name="bus",
        words="the bus's thread blocked for 3 s",
        part="bus",
        number=signal.SIGUSR1,
        hang_s=3.0,
        limit_s=None,
        lands=True,
    ),
    Case(
        name="executors",
        words="threads for blocking calls blocked for 3 s",
        part="executors",
        number=signal.SIGUSR1,
        hang_s=3.0,
        limit_s=None,
    ),
)


@dataclass(frozen=True, slots=True)
class Observation:
    """Observations of the listener in one case.

    silent_after_ms: from the fault to the last setpoint. longest_gap_ms: between two setpoints of
    the 2 s before the fault. resumed: setpoints after the part was free again. has_landed: PX4
    disarmed. is_right: the verdict.
    """

    name: str
    words: str
    silent_after_ms: float
    limit_ms: float | None
    longest_gap_ms: float
    resumed: int
    has_landed: bool
    is_right: bool


def judge(case: Case, passed: Sequence[wire.Passed], fault_ns: int, end_ns: int) -> Observation:
    """The verdict of one case.

    Args:
        passed: what passed of this vehicle. fault_ns: before the signal. end_ns: when the part was
            free again.
    """
    setpoints = [one.stamp_ns for one in passed if one.is_setpoint]
    heartbeats = [one for one in passed if not one.is_setpoint and one.stamp_ns > fault_ns]
    down_ns = next((one.stamp_ns for one in heartbeats if not one.is_armed), end_ns)
    begin_ns = fault_ns - 2 * 10**9
    until_ns = fault_ns
    if case.limit_s is None:
        begin_ns = fault_ns
        until_ns = min(end_ns, down_ns)
    shown = [begin_ns, *(stamp for stamp in setpoints if begin_ns < stamp < until_ns), until_ns]
    gap_s = max(later - earlier for earlier, later in itertools.pairwise(shown)) * 1e-9
    during = [stamp for stamp in setpoints if fault_ns < stamp <= end_ns]
    resumed = sum(stamp > end_ns for stamp in setpoints)
    silent_after_s = (max(during, default=fault_ns) - fault_ns) * 1e-9
    has_landed = bool(heartbeats) and not heartbeats[-1].is_armed
    if case.limit_s is None:
        is_right = gap_s <= PX4_WAITS_S and has_landed == case.lands
    else:
        is_right = silent_after_s <= case.limit_s and resumed == 0 and has_landed
    limit_ms = None if case.limit_s is None else 1e3 * case.limit_s
    return Observation(
        name=case.name,
        words=case.words,
        silent_after_ms=1e3 * silent_after_s,
        limit_ms=limit_ms,
        longest_gap_ms=1e3 * gap_s,
        resumed=resumed,
        has_landed=has_landed,
        is_right=is_right,
    )


async def fly(cases: Sequence[Case], folder: Path, *, is_signed: bool = False) -> list[Observation]:
    """Hover one vehicle for each case, let each hang in its way, judge what passed on the wire."""
    emulator = fleet_data(len(cases), SPACING_M, "silence")
    if is_signed:
        emulator["defaults"] |= {"mavlink_signing": True, "px4_version": "1.18"}
        _make_keys(folder / "keys", emulator["vehicles"])
    data = _other_autopilot_ports(emulator)
    parts = {f"mav{place}": case.part for place, case in enumerate(cases)}
    hang_s = {f"mav{place}": case.hang_s for place, case in enumerate(cases)}

    def command(path: str, name: str) -> list[str]:
        agent = ["--fleet", path, "--vehicle", name, "--apply-params", "--realtime"]
        return ["tests.bench.silence.agent", parts[name], str(hang_s[name]), *agent]

    bench_fleet = BenchFleet(data, folder, emulator_data=emulator, command=command)
    ways = [
        f"{name}:{_port(emulator, name)}:{_port(emulator, name) + 40}:{_port(data, name)}"
        for name in parts
    ]
    bench_fleet.processes.start(WIRE, ["tests.bench.silence.wire", str(folder / "wire.txt"), *ways])
    await bench_fleet.processes.wait_for_line(WIRE, "ready", 10.0)
    times_ns: dict[str, tuple[int, int]] = {}
    async with bench_fleet:
        await bench_fleet.fleet.takeoff(height_m=1.0)
        await asyncio.sleep(2.5)
        for name, case in zip(parts, cases, strict=True):
            times_ns[name] = await _hang(bench_fleet.processes.pids[name], case)
        landing = [
            name
            for name, case in zip(parts, cases, strict=True)
            if case.limit_s is not None or case.lands
        ]
        await _until_down(folder / "wire.txt", landing)
        passed = wire.read(folder / "wire.txt")
        await bench_fleet.fleet.land_all()
    return [
        judge(case, [one for one in passed if one.vehicle == name], *times_ns[name])
        for name, case in zip(parts, cases, strict=True)
    ]


def _make_keys(folder: Path, vehicles: Iterable[str]) -> None:
    folder.mkdir(exist_ok=True)
    for name in vehicles:
        file = folder / key_file(name)
        file.touch(mode=0o600)
        file.write_bytes(secrets.token_bytes(KEY_BYTES))


async def _hang(pid: int, case: Case) -> tuple[int, int]:
    """Let an agent hang; when that began and when it ended, on the monotonic clock."""
    fault_ns = time.monotonic_ns()
    os.kill(pid, case.number)
    await asyncio.sleep(case.hang_s or 1.0)
    end_ns = min(time.monotonic_ns(), fault_ns + round(1e9 * (case.hang_s or 1.0)))
    if case.number is signal.SIGSTOP:
        os.kill(pid, signal.SIGCONT)
    await asyncio.sleep(1.0)
    return fault_ns, end_ns


async def _until_down(log: Path, names: Sequence[str]) -> None:
    deadline_s = time.monotonic() + _DOWN_S
    while time.monotonic() < deadline_s:
        newest = {one.vehicle: one.is_armed for one in wire.read(log) if not one.is_setpoint}
        if not any(newest.get(name, True) for name in names):
            return
        await asyncio.sleep(1.0)


def _other_autopilot_ports(data: dict[str, Any]) -> dict[str, Any]:
    """The same fleet with free ports where the agents listen, since the listener has taken the
    emulator's place.
    """
    other = with_free_ports(data, fleet_from_mapping(data))
    mixed = copy.deepcopy(data)
    for name, vehicle in mixed["vehicles"].items():
        vehicle["autopilot"] = other["vehicles"][name]["autopilot"]
    return mixed


def _port(data: dict[str, Any], name: str) -> int:
    return int(data["vehicles"][name]["autopilot"].rsplit(":", 1)[1])


def table(found: Sequence[Observation]) -> str:
    """For people."""
    lines = [
        f"{'case':<17} {'last setpoint':>14} {'limit':>9} {'longest gap':>12} {'resumed':>8}  "
        "vehicle"
    ]
    for one in found:
        limit = "goes on" if one.limit_ms is None else f"{one.limit_ms:.0f} ms"
        by = "itself" if one.limit_ms is None else "PX4"
        became = f"landed by {by}" if one.has_landed else "flew on"
        lines.append(
            f"{one.name:<17} {one.silent_after_ms:>11.1f} ms {limit:>9} "
            f"{one.longest_gap_ms:>9.1f} ms "
            f"{one.resumed:>8}  {became}{'' if one.is_right else '   WRONG'}"
        )
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry of ``make bench-silence``; exit status 0 when every case is silent in time."""
    parser = argparse.ArgumentParser(
        prog="make bench-silence",
        description=f"Is the wire silent {1e3 * LIMIT_S:.0f} ms after an agent hangs? By an "
        "independent listener.",
    )
    names = [case.name for case in CASES]
    parser.add_argument(
        "--only", nargs="+", choices=names, default=names, metavar="CASE", help=", ".join(names)
    )
    parser.add_argument("--signed", action="store_true", help="with MAVLink signing")
    parser.add_argument(
        "--rounds", type=int, default=1, help="how often everything is done (default 1)"
    )
    parser.add_argument("--keep", type=Path, help="folder for the logs of all processes")
    parser.add_argument("--json", action="store_true", help="figures as JSON on stdout")
    options = parser.parse_args(argv)
    cases = [case for case in CASES if case.name in options.only]
    found: list[Observation] = []
    for _ in range(max(1, options.rounds)):
        with tempfile.TemporaryDirectory(prefix="covey-silence-") as scratch:
            folder = options.keep or Path(scratch)
            folder.mkdir(parents=True, exist_ok=True)
            try:
                found += asyncio.run(fly(cases, folder, is_signed=options.signed))
            except (ProcessError, NotReady, OrderFailed) as error:
                print(f"bench silence: {error}", file=sys.stderr)
                return EXIT_WRONG_INPUT
    print(json.dumps([asdict(one) for one in found]) if options.json else table(found))
    return EXIT_OK if all(one.is_right for one in found) else EXIT_FAILED


if __name__ == "__main__":
    sys.exit(main())
