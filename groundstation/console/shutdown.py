"""The end of the console: quitting, ctrl+c, signals, and a terminal that closes."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from collections.abc import Callable

from textual.app import App

from groundstation.console.clients import ConsoleClient
from groundstation.console.mission_worker import MissionWorker
from groundstation.console.order_entry import OrderEntry
from groundstation.console.priority_keys import TerminalHooks
from groundstation.console.screens.dialogs import QuitScreen
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.fleet.descent import longest_descent_s
from groundstation.fleet.state import VehicleView
from groundstation.orders.intents import Takeoff
from onboard.config.fleet import FleetConfig

INTERRUPTED = 130  # exit status of a program that Ctrl-C has ended
LAND_WAIT_S = 90.0  # longest wait for landings, plus the time of the descent
HANG_UP_S = 1.0  # pause after the order to land, so that it reaches all vehicles before the end


class Shutdown:
    """Ends the console; before that it lands a flying fleet, or asks the operator.

    Args:
        app: app that is ended.
        fleet: the fleet file.
        client: client of the fleet, or of a recorded flight.
        orders: gives the order to land.
        mission: mission that the console flies.
        terminal: hooks that drop all output after the terminal is closed.
        table: table of the fleet, which the question before leaving keeps in sight.
        warn: function that writes a sentence into the event log.
    """

    def __init__(
        self,
        app: App[int],
        fleet: FleetConfig,
        client: ConsoleClient,
        orders: OrderEntry,
        mission: MissionWorker,
        terminal: TerminalHooks,
        table: FleetTable,
        warn: Callable[[str], None],
    ) -> None:
        self._app = app
        self._fleet = fleet
        self._client = client
        self._orders = orders
        self._mission = mission
        self._terminal = terminal
        self._table = table
        self._warn = warn
        self._status: int | None = None  # exit status after the landing; None: no landing
        self._deadline_ns = 0  # time at which the console ends even if vehicles still fly

    @property
    def is_hung_up(self) -> bool:
        """Whether the terminal is closed, so that nothing can be drawn."""
        return self._terminal.is_closed

    @property
    def text(self) -> str:
        """The landing before the end of the console, in words; empty if there is none."""
        if self._status is None:
            return ""
        count = len(self._up)
        if count:
            return f"landing, then leaving: {count} still up"
        return "leaving"

    @property
    def _up(self) -> tuple[str, ...]:
        """Vehicles that fly, and those that take off and are still on the ground."""
        vehicles = self._client.state.vehicles
        return tuple(name for name, view in vehicles.items() if self._is_up(name, view))

    def _is_up(self, name: str, view: VehicleView) -> bool:
        if view.is_airborne:
            return True
        if view.telemetry is not None and view.telemetry.state == "taking off":
            return not view.is_disarmed_by_px4

        newest = self._orders.newest
        if newest is None or not isinstance(newest.planned.intent, Takeoff):
            return False
        return name in newest.results and newest.results[name].phase == "accepted"

    @property
    def _may_leave(self) -> bool:
        """Whether no vehicle flies or takes off, or another ground operates the fleet."""
        is_ours = self._orders.is_operator or self._mission.is_running
        return not self._up or not is_ours

    @property
    def _quit_status(self) -> int:
        if self._mission.is_running:
            return INTERRUPTED
        return self._mission.status

    def update(self) -> None:
        """End the console when all are down, or at the deadline; called at each refresh."""
        if self._status is None:
            return
        is_late = self._client.now_ns() >= self._deadline_ns
        if not self._up or is_late:
            self._app.exit(self._status)

    def quit(self) -> None:
        """End the console; if the fleet flies, ask the operator first."""
        if self._may_leave:
            self._app.exit(self._quit_status)
        elif not isinstance(self._app.screen, QuitScreen):
            screen = QuitScreen(
                lambda: self._up,
                can_stay_up=not self._mission.has_mission,
                table=self._table,
            )
            self._app.push_screen(screen, self._quit_as_answered)

    async def interrupt(self) -> None:
        """Land, then end the console, for ctrl+c and SIGTERM; a second call ends it at once."""
        if self._status is not None or self._may_leave:
            self._app.exit(INTERRUPTED)
            return
        await self._land_and_leave(INTERRUPTED)
        self._warn("Landing all, then leaving. Ctrl-C again leaves at once.")

    async def _quit_as_answered(self, answer: str | None) -> None:
        if answer and self._may_leave:  # all have landed in the meantime
            self._app.exit(self._quit_status)
        elif answer == "land":
            await self._land_and_leave(self._quit_status)
        elif answer == "leave":
            self._app.exit(self._quit_status)

    async def _land_and_leave(self, status: int) -> None:
        self._mission.cancel()
        wait_s = LAND_WAIT_S + longest_descent_s(self._fleet, self._client.state)
        self._status = status
        self._deadline_ns = self._client.now_ns() + int(wait_s * 1e9)
        await self._orders.order_all("land")

    # -- signals -----------------------------------------------------------------------------------

    def catch_signals(self) -> None:
        """Land and end on SIGTERM, as for ctrl+c, and on SIGHUP, when the terminal closes."""
        loop = asyncio.get_running_loop()

        def land_and_leave() -> None:
            self._app.run_worker(self.interrupt(), group="signal")

        def hang_up() -> None:
            self._app.run_worker(self._hang_up(), group="signal")

        # Only the main thread of a process may handle signals, and not on every system.
        with contextlib.suppress(RuntimeError, ValueError, NotImplementedError):
            loop.add_signal_handler(signal.SIGTERM, land_and_leave)
            loop.add_signal_handler(signal.SIGHUP, hang_up)

    def release_signals(self) -> None:
        """Remove the signal handlers."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGHUP):
            with contextlib.suppress(RuntimeError, ValueError, NotImplementedError):
                loop.remove_signal_handler(number)

    async def _hang_up(self) -> None:
        """Land the vehicles that this ground operates, and end, because the terminal is closed."""
        self._terminal.is_closed = True

        # Redirect standard output and error, so that no later write fails.
        null_device = os.open(os.devnull, os.O_RDWR)
        for descriptor in (1, 2):
            os.dup2(null_device, descriptor)

        if not self._may_leave:
            await self._orders.order_all("land")
            await asyncio.sleep(HANG_UP_S)
        self._app.exit(INTERRUPTED)
