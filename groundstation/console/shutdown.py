"""How a flight and the console end: the mission in its worker, its verdict, quitting, interrupts and signals."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from collections.abc import Awaitable, Callable
from typing import ClassVar

from textual.binding import Binding, BindingType
from textual.widgets import Static
from textual.worker import Worker, WorkerState

from groundstation.console import theme
from groundstation.console.order_entry import ConsoleClient, OrderingApp
from groundstation.console.screens.dialogs import QuitScreen
from onboard.config.fleet import FleetConfig

INTERRUPTED = 130
LAND_WAIT_S = 90.0
HANG_UP_S = 1.0  # for a landing to reach everybody, silent agents' PX4 included

Mission = Callable[[], Awaitable[object]]


class LeavingApp(OrderingApp):
    """An app that flies a mission, and leaves no flying fleet behind without saying so."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+c", "interrupt", "land and leave", priority=True),
        Binding("ctrl+q", "leave", "quit", priority=True),
        Binding("q", "leave", "quit"),
        Binding("v", "verdict", "verdict"),
    ]

    def __init__(
        self,
        fleet: FleetConfig,
        client: ConsoleClient,
        *,
        mission: Mission | None = None,
        connect: Mission | None = None,
        progress: Callable[[], str] | None = None,
        has_preview: bool = True,
    ) -> None:
        super().__init__(fleet, client, has_preview=has_preview)
        self._connect = connect
        self._connect_worker: Worker[object] | None = None
        self.status = 0
        self._mission = mission
        self._progress = progress
        self._leaving: int | None = None
        self._leave_by_ns = 0
        self.is_hung_up = False
        self._mission_worker: Worker[object] | None = None
        self._mission_line = ""
        self._verdict = Static(id="verdict", markup=False)

    # -- the mission -------------------------------------------------------------------------------------------------

    def start_mission(self) -> None:
        """Connect and fly the mission, if there is one, in workers: the screen does not wait for either."""
        if self._connect is not None:
            self._connect_worker = self.run_worker(_awaited(self._connect), exit_on_error=False)
        if self._mission is not None:
            self._mission_line = "mission flies"
            self._mission_worker = self.run_worker(self._fly(self._mission), exit_on_error=False)

    @property
    def is_flying_mission(self) -> bool:
        """Whether a mission is under way."""
        return self._mission_worker is not None and self._mission_worker.is_running

    def progress_text(self, clock: str) -> str:
        """Where the mission is, or what is waited for before leaving."""
        if self._leaving is not None:
            up = self.client.state.airborne_names
            return f"landing, then leaving: {len(up)} still up" if up else "leaving"
        if self.is_flying_mission and self._progress is not None:
            return self.short(self._progress() or self._mission_line)
        return f"{self._mission_line}{clock if self._mission_line == 'mission flies' else ''}"

    async def _fly(self, mission: Mission) -> object:
        verdict = await mission()
        sentences = getattr(verdict, "sentences", None) or str(verdict).splitlines()
        is_good = bool(getattr(verdict, "is_passed", getattr(verdict, "passed", True)))
        status = getattr(verdict, "exit_status", None)
        self.status = status if isinstance(status, int) else 0 if is_good else 1
        self._show_verdict([theme.clean(sentence) for sentence in sentences], self.status == 0)
        return verdict

    def _show_verdict(self, sentences: list[str], is_good: bool) -> None:
        box = self._verdict
        box.border_title = "✔ mission passed" if is_good else "✖ mission failed"
        box.border_subtitle = "v hides · q quits"
        box.set_class(not is_good, "bad")
        self._open_verdict(True)
        box.update("\n".join(sentences))
        self._mission_line = "✔ mission passed" if is_good else "✖ mission failed"
        for sentence in sentences:
            self._event_log.write(sentence, severity="info" if is_good else "warning")

    def on_worker_state_changed(self, event: Worker.StateChanged) -> None:
        """A mission that breaks is a sentence here; the vehicles are still under the operator's orders."""
        if event.worker is self._mission_worker and event.state is WorkerState.ERROR:
            self.status = 1
            error = event.worker.error
            self._show_verdict([f"The mission broke off: {type(error).__name__}: {error}", "Land with ctrl+l."], False)
        elif event.worker is self._connect_worker and event.state is WorkerState.ERROR:
            self._event_log.write(f"No connection: {event.worker.error} Press q to quit.", severity="critical")
            self.status = 2

    def action_verdict(self) -> None:
        """Hide or show the verdict."""
        box = self._verdict
        if box.border_title:
            self._open_verdict(not box.display)

    def _open_verdict(self, is_open: bool) -> None:
        """It stands where the events are, which tell the same: the plan keeps its room."""
        self._verdict.display = is_open
        self.screen_stack[0].set_class(is_open, "judged")

    # -- leaving -----------------------------------------------------------------------------------------------------

    @property
    def is_watching(self) -> bool:
        """Whether somebody else operates: then leaving changes nothing for the vehicles."""
        return self.control is None or self.control.refusal("move") is not None

    def leave_when_down(self) -> None:
        """Called often: leaves as soon as nobody flies any more, or says that they do not come down."""
        if self._leaving is None:
            return
        if not self.client.state.airborne_names or self.client.now_ns() >= self._leave_by_ns:
            self.exit(self._leaving)

    async def action_leave(self) -> None:
        """Quit; a flying fleet is asked about first."""
        flying = self.client.state.airborne_names
        if not flying or self._leaves_others_alone():
            self.exit(INTERRUPTED if self.is_flying_mission else self.status)
        elif not isinstance(self.screen, QuitScreen):
            self.push_screen(QuitScreen(flying, can_stay_up=self._mission is None), self._leave_as_answered)

    async def _leave_as_answered(self, answer: str | None) -> None:
        if answer == "land":
            await self._land_and_leave(INTERRUPTED if self.is_flying_mission else self.status)
        elif answer == "leave":
            self.exit(self.status)

    async def _land_and_leave(self, status: int) -> None:
        if self._mission_worker is not None:
            self._mission_worker.cancel()
        self._leaving, self._leave_by_ns = status, self.client.now_ns() + int(LAND_WAIT_S * 1e9)
        await self.action_order_all("land")

    async def action_interrupt(self) -> None:
        """Ctrl-C: land, then leave; a second one leaves at once. Who only watches leaves at once."""
        if self._leaving is not None or not self.client.state.airborne_names or self._leaves_others_alone():
            self.exit(INTERRUPTED)
            return
        await self._land_and_leave(INTERRUPTED)
        self._event_log.write("Landing all, then leaving. Ctrl-C again leaves at once.", severity="warning")

    def _leaves_others_alone(self) -> bool:
        return self.is_watching and not self.is_flying_mission

    # -- signals -----------------------------------------------------------------------------------------------------

    def catch_signals(self) -> None:
        """A terminal that closes, or a kill: as ctrl+c, so that who flies lands and the terminal is restored."""
        loop = asyncio.get_running_loop()
        with contextlib.suppress(RuntimeError, ValueError, NotImplementedError):
            loop.add_signal_handler(signal.SIGTERM, lambda: self.run_worker(self.action_interrupt(), group="signal"))
            loop.add_signal_handler(signal.SIGHUP, lambda: self.run_worker(self._hang_up(), group="signal"))

    def release_signals(self) -> None:
        """The console is over; what began it listens to signals again."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGHUP):
            with contextlib.suppress(RuntimeError, ValueError, NotImplementedError):
                loop.remove_signal_handler(number)

    async def _hang_up(self) -> None:
        """The terminal is gone: land who is ours, and end."""
        self.is_hung_up = True
        nowhere = os.open(os.devnull, os.O_RDWR)
        for descriptor in (1, 2):
            os.dup2(nowhere, descriptor)
        # Textual's thread that writes may have died of the terminal; nobody is to wait for room in its queue.
        queue = getattr(getattr(self._driver, "_writer_thread", None), "_queue", None)
        if queue is not None:
            queue.maxsize = 0
        if self.client.state.airborne_names and not self._leaves_others_alone():
            await self.action_order_all("land")
            await asyncio.sleep(HANG_UP_S)
        self.exit(INTERRUPTED)

    async def on_unmount(self) -> None:
        """Nothing is left behind."""
        self.release_signals()
        await super().on_unmount()


async def _awaited(function: Mission) -> object:
    return await function()
