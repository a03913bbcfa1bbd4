"""One flight of a mission from the command line, in real time.

:class:`MissionFlight` does the following, in this order:

1. the record opens, and in a simulated flight emulator and agents start,
2. the client connects with the fleet, and the mission runs, with the console or without,
3. the record closes, and the verdict is computed from it,
4. all processes end, whatever has happened before.

The first interrupt lands the vehicles. The second one ends everything at once. A process that ends
by itself, or a fleet that falls silent, aborts the mission.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shlex
import sys
import time
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path

from groundstation.client.client import FleetClient
from groundstation.flights.flight_settings import FlightSettings
from groundstation.flights.interruption import listen, listen_no_more
from groundstation.flights.left_tasks import end_other_tasks, leave_process
from groundstation.flights.simulation_settings import emulator_options
from groundstation.missions.lasting_output import lasting_output
from groundstation.missions.runner import READY_TIMEOUT_SIM_S, MissionRun
from groundstation.processes.fleet_processes import EMULATOR, start_fleet
from groundstation.processes.priority import take_priority
from groundstation.processes.supervisor import ProcessError, Processes
from groundstation.recording.channels import RECORDED
from groundstation.recording.disk_room import room_warning
from groundstation.recording.timeline import Timeline
from groundstation.recording.writer import RecordWriter
from groundstation.verdict.final_verdict import final_verdict
from groundstation.verdict.verdict import Verdict
from onboard.bus.schema import Event
from onboard.config.config_error import ConfigError
from onboard.exit_status import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_WRONG_INPUT
from onboard.plain_text import plain_line, plain_lines

READY_TIMEOUT_S = 10.0  # longest wait until agents that run already are ready
_PROCESS_CHECK_PERIOD_S = 0.2

Say = Callable[[str], None]


class MissionFlight:
    """A flight under way; the caller calls only :meth:`fly`."""

    def __init__(self, settings: FlightSettings, *, say: Say) -> None:
        self.settings = settings
        self._fleet = settings.mission.fleet
        self._print = say
        self._last_line = ""  # last line of progress, for the console
        self._processes = Processes(settings.folder)
        self._client: FleetClient | None = None
        self._record: RecordWriter | None = None
        self._run: MissionRun | None = None
        self._verdicts: list[Verdict] = []  # verdicts on the missions of this flight so far
        self._main: asyncio.Task[int] | None = None
        self._signals = 0  # number of interrupts so far

    async def fly(self) -> int:
        """Fly from the first process to the verdict; return the exit status."""
        with lasting_output():
            status = await self._fly_and_listen()
        if not await end_other_tasks():
            leave_process(status)
        return status

    async def _fly_and_listen(self) -> int:
        """Fly, and land at the first signal; return the exit status."""
        self._main = asyncio.current_task()
        self._listen()
        try:
            return await self._fly()
        except ProcessError as error:
            self._print(str(error))
            if self._run is None:
                return EXIT_WRONG_INPUT
            return EXIT_FAILED
        except asyncio.CancelledError:
            if self._signals < 2:
                raise
            self._print("Ended at once; no process is left.")
            return EXIT_INTERRUPTED
        finally:
            listen_no_more()

    async def _fly(self) -> int:
        """Open the flight and fly the mission, with the console or without."""
        ready_timeout_s = READY_TIMEOUT_S
        if self.settings.is_simulated:
            ready_timeout_s = READY_TIMEOUT_SIM_S

        if self.settings.at is not None:
            wait_s = self.settings.at.wall_ns * 1e-9 - time.time()
            vehicles = len(self._fleet.enabled_names)
            warning = room_warning(self.settings.folder, wait_s=wait_s, vehicles=vehicles)
            if warning:
                self._print(warning)

        async with self._open() as client:
            run = MissionRun(
                self.settings.mission,
                client,
                say=self._say,
                ready_timeout_s=ready_timeout_s,
                stays=self.settings.is_headless,
                at=self.settings.at,
            )
            self._run = run
            if self._signals:  # an interrupt came before there was a run
                run.interrupt()

            watch = asyncio.create_task(self._watch_processes(run))
            try:
                if self.settings.is_headless:
                    return await self._fly_headless(client)
                status = await self._fly_in_console(client)
            finally:
                watch.cancel()

        # The record is closed now, so what it holds is known.
        mission_name = f"mission{Path(self.settings.mission.path).suffix}"
        for line in next_commands(self.settings.folder, mission_name):
            self._print(line)
        return status

    async def _fly_headless(self, client: FleetClient) -> int:
        client.add_event_listener(self._print_event)
        verdict = await self._mission()
        for line in verdict.sentences:
            self._print(line)
        return verdict.exit_status

    async def _fly_in_console(self, client: FleetClient) -> int:
        """Fly the mission in the console; return the exit status when the operator leaves it."""
        # Imported here: a headless flight needs no textual.
        from groundstation.console.app import ConsoleApp
        from groundstation.orders.forecast_process import Forecaster

        title = self.settings.mission.name
        if self.settings.is_simulated:  # agents that run already fly a law of their own
            title = f"{title} - law {self._fleet.law.name}"

        try:
            console = ConsoleApp(
                self._fleet,
                client,
                mission=self._mission,
                title=title,
                progress=self._progress,
                run=self._run,
                judge=self._judge,
                forecaster=Forecaster(),
            )
            status = await console.run_to_end()
            self._print_end(console.mission.verdict)
            return status
        finally:
            self._listen()  # until now the console has handled the signals

    def _print_end(self, sentences: Sequence[str]) -> None:
        """Print the verdict, after the console has left the terminal."""
        if not sentences:
            sentences = ["The console was left before the end of the mission: there is no verdict."]
        for line in sentences:
            self._print(plain_lines(line))
        for earlier in self._verdicts[:-1]:
            self._print(plain_lines(f"Before it: {earlier.summary}"))

    @contextlib.asynccontextmanager
    async def _open(self) -> AsyncIterator[FleetClient]:
        """Open the record, start the processes and connect; close all of it at the end."""
        client = FleetClient(self._fleet, extra_topics=RECORDED)
        record = RecordWriter(
            self.settings.folder,
            on_failure=self._record_failed,
            on_warning=lambda sentence: client.publish_event("warning", "record_full", sentence),
        )
        self._client = client
        self._record = record

        try:
            record.start()
            client.add_sink(record.put)

            if self.settings.is_simulated:
                count = len(self._fleet.enabled_names)
                folder = self.settings.folder
                place = shown_folder(folder)
                self._say(f"Starting the emulator and {count} agents; everything goes to {place}.")
                simulation = self.settings.simulation
                start_fleet(
                    self._fleet,
                    folder,
                    simulation.seed,
                    self._processes,
                    emulator_options=emulator_options(simulation),
                )

            await client.start()
            client.publish_event("debug", "priority", take_priority())
            client.announce_recording(record.failure is None)
            yield client
        finally:
            # The processes end in any case: kill() runs even if an await here is cancelled.
            try:
                await self._processes.stop()
                await client.stop()
                await asyncio.to_thread(record.stop)
            finally:
                self._processes.kill()

    def _record_failed(self, sentence: str) -> None:
        if self._client is None:
            return
        self._client.publish_event("critical", "record_failed", sentence)
        if self._client.is_started:
            self._client.announce_recording(False)

    async def _mission(self) -> Verdict:
        """Run the mission to its end; return the verdict on the record."""
        assert self._run is not None
        await self._run.run()
        return await self._judge(self._run)

    async def _judge(self, run: MissionRun) -> Verdict:
        """Return the verdict on a mission that has ended, by the record so far."""
        assert self._record is not None
        if self.settings.is_headless and self._client is not None:
            await asyncio.to_thread(self._record.stop)
            record_end = self._record.end
        else:
            # With a console the record goes on until the operator leaves. The verdict needs only
            # the messages until now.
            record_end = await asyncio.to_thread(self._record.end_so_far)

        verdict = await asyncio.to_thread(
            final_verdict,
            run.flown(),
            run.mission.expect,
            self.settings.folder,
            record_end,
            earlier=tuple(self._verdicts),
        )
        self._verdicts.append(verdict)
        return verdict

    async def _watch_processes(self, run: MissionRun) -> None:
        """End the mission if a process has ended, or if the fleet is taken or silent."""
        while True:  # asyncio cannot wait for the end of these children, so it looks at intervals
            await asyncio.sleep(_PROCESS_CHECK_PERIOD_S)

            dead = self._processes.dead()
            if dead:
                reason = ". ".join(process.ending.removesuffix(".") for process in dead)
                if self._client is not None:
                    self._client.publish_event("critical", "process_ended", reason)

                names = [process.name for process in dead]
                run.abort(reason, can_land=EMULATOR not in names)
                return

            if run.check():
                return

    def _listen(self) -> None:
        # A console has its own keys, and would leave the terminal as it is.
        on_blocked = self._end_blocked if self.settings.is_headless else None
        listen(self.settings.mission.path, self._on_signal, on_blocked)

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

    def _end_blocked(self) -> None:
        """End the process, because the mission's code never lets the event loop go on.

        For the agents it is a ground that is lost.
        """
        land_s = self._fleet.fleet.ground_lost_land_s
        sentence = (
            "Ended at once: the mission's code never awaits, so nothing could be ordered. "
            "Simulated vehicles end with it; others finish their order, hold, and land after "
            f"{land_s:g} s without a ground.\n"
        )
        os.write(sys.stderr.fileno(), sentence.encode())  # a print may be under way just now
        os._exit(EXIT_INTERRUPTED)

    def _progress(self) -> str:
        """Return one line about the mission, for the console."""
        if self._run is not None and self._run.fleet.ground.title_line:
            return self._run.fleet.ground.title_line
        return self._last_line

    def _say(self, line: str) -> None:
        """Report a line of progress: to console or output, and as an event on the bus."""
        self._last_line = line.strip()
        if self.settings.is_headless:
            self._print(line)
        if self._client is not None:
            self._client.publish_event("info", "mission", line.strip())

    def _print_event(self, event: Event) -> None:
        if event.severity in ("warning", "critical"):
            self._print(f"  [{event.vehicle}] {event.severity}: {plain_line(event.sentence)}")


def shown_folder(folder: Path) -> Path:
    """Return a folder as it is shown: one in the current folder by its relative path."""
    if folder.absolute().is_relative_to(Path.cwd()):
        return folder.absolute().relative_to(Path.cwd())
    return folder


def next_commands(folder: Path, mission_name: str) -> list[str]:
    """Return where a flight has been recorded, and commands that look at it, a line each.

    Commands that would refuse the record are left out. A start that was left early has no vehicle.

    Args:
        folder: the flight folder, with a record that is closed.
        mission_name: file name of the mission in it.
    """
    shown = shown_folder(folder)
    flight = shlex.quote(str(shown))
    files = f"{flight}/{mission_name} --fleet {flight}/fleet.toml"
    if (folder / "verdict.json").exists():
        lines = [f"Record, events, logs and verdict: {shown}"]
    else:
        lines = [f"Record, events and logs: {shown}"]

    has_vehicles = False
    has_ticks = False
    with (
        contextlib.suppress(ConfigError),  # nothing was recorded
        contextlib.closing(Timeline(folder)) as timeline,
    ):
        has_vehicles = bool(timeline.vehicles)
        has_ticks = "tick" in timeline.topics

    if has_vehicles:
        lines.append(f"  see it again:    covey replay {flight}")
        lines.append(f"  in a browser:    covey report {flight}")
    if has_ticks:
        lines.append(f"  draw it:         covey plot {flight}")
    lines.append(f"  how closely this can be flown: covey check {files}")
    return lines


def clock_say() -> Say:
    """Return a function that prints lines with the seconds since this call."""
    begin_s = time.monotonic()

    def say(line: str) -> None:
        print(f"{time.monotonic() - begin_s:6.1f} s  {plain_lines(line)}", flush=True)

    return say
