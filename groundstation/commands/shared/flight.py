"""One flight from the command line: folder, processes, client, record, mission, verdict; and all
ended after it.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import time
import tomllib
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from msgspec.structs import replace

from groundstation.client.client import FleetClient
from groundstation.commands.shared.interruption import listen, listen_no_more
from groundstation.mission_files.loading import load_mission, with_fleet
from groundstation.mission_files.mission import Mission
from groundstation.mission_files.mission_findings import refuse_unflyable
from groundstation.missions.runner import READY_TIMEOUT_SIM_S, MissionRun, load_function
from groundstation.processes.free_ports import (
    busy_ports,
    in_another_folder,
    is_free_endpoint,
    is_local,
    toml_text,
    with_free_ports,
)
from groundstation.processes.supervisor import ProcessError, Processes, agent_command, leaves_room
from groundstation.recording.channels import RECORDED
from groundstation.recording.writer import FLUSH_PERIOD_S, RECORD_NAME, RecordWriter
from groundstation.verdict.final_verdict import final_verdict
from groundstation.verdict.verdict import Verdict
from onboard.bus.schema import Event
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping
from onboard.exit_status import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_WRONG_INPUT
from onboard.plain_text import plain_line, plain_lines

EMULATOR = "sitl"
READY_TIMEOUT_S = 10.0

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Settings:
    """A flight, checked: what to fly, where to write, and whether emulator and agents are ours to
    start.
    """

    mission: Mission
    folder: Path
    is_simulated: bool
    is_headless: bool
    seed: int


def prepare(
    mission: Mission | str,
    folder: Path,
    *,
    fleet_path: str | None,
    law: str | None,
    is_simulated: bool,
    has_free_ports: bool,
    is_headless: bool,
    seed: int,
    needs_ports: bool = True,
    arguments: Mapping[str, str] = MappingProxyType({}),
) -> Settings:
    """Check everything before anything starts, and put the files that are really used into the
    folder.

    Args:
        mission: as it was read, or its path.
        needs_ports: False for a flight without sockets.
        arguments: of a Python mission, as they were written.
    Raises:
        ConfigError: wrong files, wrong combination, ports in use, no terminal, a folder that cannot
            be used.
    """
    if law is not None and not is_simulated:
        raise ConfigError(
            "--law is for simulated flights: agents that run already fly the law of their fleet file."
        )
    if isinstance(mission, str):
        mission = load_mission(mission, fleet_path)
    if arguments and not mission.is_python:
        raise ConfigError(f"{mission.path}: only Python missions have arguments. Leave --arg out.")
    mission = replace(mission, arguments=arguments)
    if mission.is_python:
        load_function(mission)  # a mistake in it is found before anything starts
    if is_simulated:
        fleet = simulated_fleet(
            mission.fleet, folder, law=law, has_free_ports=has_free_ports, needs_ports=needs_ports
        )
        mission = with_fleet(mission, fleet)
    refuse_unflyable(mission, is_simulated)
    files = {"fleet.toml": mission.fleet.text, f"mission{Path(mission.path).suffix}": mission.text}
    open_folder(folder, files, is_headless=is_headless)
    return Settings(mission, folder, is_simulated, is_headless, seed)


def open_folder(folder: Path, files: Mapping[str, str], *, is_headless: bool) -> None:
    """Make the folder of a new flight with the files that it is flown from.

    Raises:
        ConfigError: there is no terminal for the console, or the folder cannot take a flight.
    """
    if not is_headless and not sys.stdout.isatty():
        raise ConfigError("The console needs a terminal, and this output is none. Add --headless.")
    if (folder / RECORD_NAME).exists():
        raise ConfigError(
            f"{folder}: this folder holds a flight already. Choose another with --record."
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(
            f"{folder}: cannot be written ({error.strerror}). Choose another with --record."
        ) from None


def simulated_fleet(
    fleet: FleetConfig, folder: Path, *, law: str | None, has_free_ports: bool, needs_ports: bool
) -> FleetConfig:
    """Return the fleet of a simulated flight, with this law, and on ports of this machine.

    Raises:
        ConfigError: ports are in use.
    """
    fleet = _own_fleet(fleet, folder, law, has_free_ports or (needs_ports and not is_local(fleet)))
    busy = busy_ports(fleet) if needs_ports else []
    if busy:
        more = f" ({len(busy)} ports are in use)" if len(busy) > 1 else ""
        raise ConfigError(
            f"{fleet.path}: {busy[0]}{more} Another emulator or fleet runs here: stop it, change the "
            "endpoints, or fly with covey demo, which picks free ones."
        )
    return fleet


def _own_fleet(
    fleet: FleetConfig, folder: Path, law: str | None, has_free_ports: bool
) -> FleetConfig:
    data = tomllib.loads(fleet.text)
    for vehicle in data["vehicles"].values():
        vehicle.pop("emulated", None)  # here all are
    if law is not None:
        data["law"] = {**data.get("law", {}), "name": law}
    data = in_another_folder(data, fleet)
    if has_free_ports:
        data = with_free_ports(data, fleet)
    text = toml_text(
        data,
        f"Made from {fleet.path} for this flight; attach with: covey tui --fleet {folder}/fleet.toml",
    )
    return fleet_from_mapping(data, path=str(folder / "fleet.toml"), text=text)


def start_processes(settings: Settings, processes: Processes) -> None:
    """Emulator and agents, all at once: they find each other whatever the order. ProcessError when
    one cannot start.
    """
    start_fleet(settings.mission.fleet, settings.folder, settings.seed, processes)


def start_fleet(fleet: FleetConfig, folder: Path, seed: int, processes: Processes) -> None:
    """Start the emulator and the agents of the ``fleet.toml`` in a folder."""
    path, names = str(folder / "fleet.toml"), fleet.enabled_names
    for number, endpoint in enumerate(fleet.fleet.routers):
        if is_free_endpoint(endpoint):  # otherwise one is running
            processes.start(
                f"router{number}", ["groundstation", "router", path, "--endpoint", endpoint]
            )
    processes.start(EMULATOR, ["sitl", "--fleet", path, "--seed", str(seed)])
    for name in names:
        processes.start(name, agent_command(path, name, is_realtime=leaves_room(len(names))))


class MissionFlight:
    """A flight under way; :meth:`fly` is the one thing to call."""

    def __init__(self, settings: Settings, *, say: Say) -> None:
        self.settings = settings
        self._fleet = settings.mission.fleet
        self._print = say
        self._last_line = ""
        self._processes = Processes(settings.folder)
        self._client: FleetClient | None = None
        self._record: RecordWriter | None = None
        self._run: MissionRun | None = None
        self._main: asyncio.Task[int] | None = None
        self._signals = 0

    async def fly(self) -> int:
        """From the first process to the verdict; the exit status."""
        self._main = asyncio.current_task()
        self._listen()
        try:
            return await self._fly()
        except ProcessError as error:
            self._print(str(error))
            return EXIT_WRONG_INPUT if self._run is None else EXIT_FAILED
        except asyncio.CancelledError:
            if self._signals < 2:
                raise
            self._print("Ended at once; no process is left.")
            return EXIT_INTERRUPTED
        finally:
            listen_no_more()

    async def _fly(self) -> int:
        async with self._open() as client:
            run = self._run = MissionRun(
                self.settings.mission,
                client,
                say=self._say,
                ready_timeout_s=READY_TIMEOUT_SIM_S
                if self.settings.is_simulated
                else READY_TIMEOUT_S,
            )
            if self._signals:
                run.interrupt()
            watch = asyncio.create_task(self._watch_processes(run))
            try:
                if self.settings.is_headless:
                    client.add_event_listener(self._print_event)
                    verdict = await self._mission()
                    for line in verdict.sentences:
                        self._print(line)
                    return verdict.exit_status
                from groundstation.console.app import ConsoleApp
                from groundstation.orders.forecast_process import Forecaster

                # else the agents' own
                law = f" - law {self._fleet.law.name}" if self.settings.is_simulated else ""
                title = self.settings.mission.name + law
                try:
                    console = ConsoleApp(
                        self._fleet,
                        client,
                        mission=self._mission,
                        title=title,
                        progress=lambda: self._last_line,
                        forecaster=Forecaster(),
                    )
                    status = await console.run_to_end()
                    self._print_end(console.mission.verdict)
                    return status
                finally:
                    self._listen()  # the console has listened instead
            finally:
                watch.cancel()

    def _print_end(self, sentences: Sequence[str]) -> None:
        """Print the verdict and what to type next, when the console has left the terminal."""
        folder = self.settings.folder
        mission = folder / f"mission{Path(self.settings.mission.path).suffix}"
        for line in sentences or [
            "The console was left before the end of the mission: there is no verdict."
        ]:
            self._print(plain_lines(line))
        self._print(f"Record, events, logs and verdict: {folder}")
        for command, what in (
            (f"covey replay {folder}", "see it again"),
            (f"covey plot {folder}", "draw it"),
            (f"covey check {mission} --fleet {folder}/fleet.toml", "how closely this can be flown"),
        ):
            self._print(f"  {command:<50} {what}")

    @contextlib.asynccontextmanager
    async def _open(self) -> AsyncIterator[FleetClient]:
        client = self._client = FleetClient(self._fleet, extra_topics=RECORDED)
        record = self._record = RecordWriter(
            self.settings.folder,
            on_failure=self._record_failed,
            on_warning=lambda sentence: client.publish_event("warning", "record_full", sentence),
        )
        try:
            record.start()
            client.add_sink(record.put)
            if self.settings.is_simulated:
                names = self._fleet.enabled_names
                self._say(
                    f"Starting the emulator and {len(names)} agents; everything goes to {self.settings.folder}."
                )
                start_processes(self.settings, self._processes)
            await client.start()
            client.announce_recording(record.failure is None)
            yield client
        finally:
            # Whatever interrupts the clearing up, the processes end: kill() runs even if an await
            # here is cancelled.
            try:
                await self._processes.stop()
                await client.stop()
                await asyncio.to_thread(record.stop)
            finally:
                self._processes.kill()

    def _record_failed(self, sentence: str) -> None:
        if self._client is not None:
            self._client.publish_event("critical", "record_failed", sentence)
            if self._client.is_started:
                self._client.announce_recording(False)

    async def _mission(self) -> Verdict:
        assert self._run is not None
        assert self._record is not None
        await self._run.run()
        if self.settings.is_headless and self._client is not None:
            # The record ends with the flight; in the console it goes on until the operator leaves.
            await asyncio.to_thread(self._record.stop)
        else:
            await asyncio.sleep(FLUSH_PERIOD_S + 0.3)
        return await asyncio.to_thread(
            final_verdict,
            self._run.flown(),
            self.settings.mission.expect,
            self.settings.folder,
            begin_ns=self._record.begin_ns,
            record_failure=self._record.failure,
        )

    async def _watch_processes(self, run: MissionRun) -> None:
        while True:  # the kernel sets no asyncio.Event when a child ends
            await asyncio.sleep(0.2)
            dead = self._processes.dead()
            if dead:
                names = [one.name for one in dead]
                reason = ". ".join(one.ending.removesuffix(".") for one in dead)
                if self._client is not None:
                    self._client.publish_event("critical", "process_ended", reason)
                run.abort(reason, can_land=EMULATOR not in names)
                return
            if run.abort_if_silent():
                return

    def _listen(self) -> None:
        listen(self.settings.mission.path, self._on_signal)

    def _on_signal(self) -> None:
        self._signals += 1
        if self._signals == 1:
            self._print("Interrupt again to end at once, without waiting for a landing.")
            if self._run is not None:
                self._run.interrupt()
        else:
            self._processes.kill()
            if self._main is not None:
                self._main.cancel()

    def _say(self, line: str) -> None:
        self._last_line = line.strip()
        if self.settings.is_headless:
            self._print(line)
        if self._client is not None:
            self._client.publish_event("info", "mission", line.strip())

    def _print_event(self, event: Event) -> None:
        if event.severity in ("warning", "critical"):
            self._print(f"  [{event.vehicle}] {event.severity}: {plain_line(event.sentence)}")


def clock_say() -> Say:
    """Print lines with seconds since now."""
    begin_s = time.monotonic()

    def say(line: str) -> None:
        print(f"{time.monotonic() - begin_s:6.1f} s  {plain_lines(line)}", flush=True)

    return say
