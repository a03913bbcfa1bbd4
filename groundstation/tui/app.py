"""The console: puts the widgets together, refreshes them ten times a second, turns keys and words into orders."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import ClassVar, Protocol

from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import Static
from textual.worker import Worker, WorkerState

from groundstation.alerts import Alarms
from groundstation.fleet import FleetState, LoggedEvent
from groundstation.handle import OrderHandle, VehicleResult
from groundstation.orders import Intent, OrderError
from groundstation.tui import look
from groundstation.tui.dress import DressedApp
from groundstation.tui.history import History
from groundstation.tui.panels import rooms
from groundstation.tui.screens.alarms import AlarmsScreen
from groundstation.tui.screens.dialogs import HelpScreen, QuitScreen
from groundstation.tui.screens.live import LiveScreen
from groundstation.tui.widgets.bars import ResultLine, StatusBar, TitleBar
from groundstation.tui.widgets.event_log import EventLog
from groundstation.tui.widgets.fleet_table import FleetTable
from groundstation.tui.widgets.lines import Lines
from groundstation.tui.widgets.order_line import OrderLine
from groundstation.tui.widgets.plan_view import PlanView
from groundstation.tui.widgets.separation import SeparationView
from onboard.config import FleetConfig

REFRESH_S = 0.1
KILL_WINDOW_S = 1.0
INTERRUPTED = 130


class ConsoleClient(Protocol):
    """What the console needs of :class:`groundstation.client.FleetClient`."""

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""

    def now_ns(self) -> int:
        """The clock that ages are counted on."""

    async def submit(self, order: Intent | str) -> OrderHandle:
        """Send an order; results fill in."""


Mission = Callable[[], Awaitable[object]]


class ConsoleApp(DressedApp):
    """One screen for one fleet. ``mission`` flies in a worker; its verdict stays until the operator quits."""

    CSS_PATH = "style.tcss"
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+l,f9", "order_all('land')", "LAND ALL", priority=True),
        Binding("ctrl+o,f8", "order_all('hold')", "HOLD ALL", priority=True),
        Binding("f12", "kill('f12')", "KILL", priority=True),
        Binding("ctrl+backslash", "kill('ctrl+backslash')", "KILL", priority=True),
        Binding("ctrl+c", "interrupt", "land and leave", priority=True),
        Binding("ctrl+q", "leave", "quit", priority=True),
        Binding("q", "leave", "quit"),
        Binding("question_mark", "help", "help"),
        Binding("colon", "order_line", "order"),
        Binding("escape", "back", "back"),
        Binding("plus,equals_sign", "zoom(1.5)", "zoom in"),
        Binding("minus", "zoom(0.6666666667)", "zoom out"),
        Binding("0", "zoom(0)", "whole fence"),
        Binding("pageup", "look_back(1)", "earlier events"),
        Binding("pagedown", "look_back(-1)", "later events"),
        Binding("v", "verdict", "verdict"),
        Binding("a", "acknowledge", "acknowledge alarms"),
        Binding("A", "alarms", "alarms"),
    ]

    def __init__(
        self,
        fleet: FleetConfig,
        client: ConsoleClient,
        *,
        mission: Mission | None = None,
        title: str = "",
        progress: Callable[[], str] | None = None,
        has_bell: bool = False,
    ) -> None:
        super().__init__()
        self.fleet = fleet
        self.client = client
        self.status = 0
        self._mission = mission
        self._progress = progress
        self._fleet_title = title or fleet.fleet.name
        self.alarms = Alarms(fleet)
        self.has_bell = has_bell
        self._history = History(fleet.fleet.battery_land_pct / 100.0)
        self._last_event: LoggedEvent | None = None
        self._kill: tuple[str, str, float] | None = None
        self._handle: OrderHandle | None = None
        self._leaving: int | None = None
        self._mission_worker: Worker[object] | None = None
        self._mission_line = ""
        # Held here, not looked up: a timer may still come while the screen is being taken apart.
        self._title_bar = TitleBar("title")
        self._fleet_table = FleetTable(fleet, self._history)
        self._plan = PlanView(fleet, self._history)
        self._separation = SeparationView(fleet, self._history)
        self._event_log = EventLog()
        self._verdict = Static(id="verdict", markup=False)
        self._result_line = ResultLine("result")
        self._order_line = OrderLine(fleet)
        self._status_bar = StatusBar("status")

    def compose(self) -> ComposeResult:
        """Title, fleet, plan beside separation and events, verdict, order line, status."""
        yield self._title_bar
        yield self._fleet_table
        with Horizontal(id="middle"):
            yield self._plan
            with Vertical(id="right"):
                yield self._separation
                yield self._verdict
                yield self._event_log
        yield self._result_line
        with Horizontal(id="line"):
            yield Static(" : ", id="prompt", markup=False)
            yield self._order_line
        yield self._status_bar

    def on_mount(self) -> None:
        """Start looking, then flying."""
        self._fleet_table.focus()
        self._event_log.write(
            f"Fleet '{self.fleet.fleet.name}': {len(self.fleet.enabled_names)} vehicles. Press ? for help."
        )
        self.set_interval(REFRESH_S, self.refresh_fleet)
        if self._mission is not None:
            self._mission_line = "mission flies"
            self._mission_worker = self.run_worker(self._fly(self._mission), exit_on_error=False)

    def on_resize(self, event: events.Resize) -> None:
        """Other sizes, other rooms."""
        self._give_rooms(event.size.width, event.size.height)

    def on_lines_alone(self, message: Lines.Alone) -> None:
        """A panel takes all the room, or gives it back."""
        self._give_rooms(*self.size, message.name)

    def _give_rooms(self, width: int, height: int, alone: str | None = None) -> None:
        screen = self.screen_stack[0]
        if alone is None:
            alone = next((name.removeprefix("only-") for name in screen.classes if name.startswith("only-")), "")
        count = len(self.client.state.vehicles)
        self._fleet_table.styles.height, self._plan.styles.width = rooms(
            width, height, count, self.fleet.fleet.geofence_m, alone
        )

    # -- what is seen ----------------------------------------------------------------------------------------------

    def refresh_fleet(self) -> None:
        """Draw the fleet as it is now."""
        state, now_ns = self.client.state, self.client.now_ns()
        self._history.add(state, now_ns)
        self._write_new_events(state)
        self._fleet_table.show(state, now_ns)
        self._plan.show(state, now_ns, self._fleet_table.selected, self._fleet_table.marked)
        self._separation.show(state, now_ns)
        heard = sum(view.is_fresh(now_ns) for view in state.vehicles.values())
        title = self._title_bar
        title.show(self._fleet_title, heard, len(state.vehicles), len(state.airborne_names), self._mission_text(now_ns))
        if self._kill is not None and now_ns * 1e-9 - self._kill[2] > KILL_WINDOW_S:
            self._kill = None
        self.alarms.update(state, now_ns)
        if self.has_bell and self.alarms.is_news:
            self.bell()
        self._status_bar.show(self.alarms, now_ns, self._kill[1] if self._kill else None)
        if isinstance(self.screen, LiveScreen):
            self.screen.show_fleet(state, now_ns, self._kill[1] if self._kill else None)
        if self._leaving is not None and not state.airborne_names:
            self.exit(self._leaving)

    def _mission_text(self, now_ns: int) -> str:
        if self._leaving is not None:
            return "landing, then leaving"
        if self._mission_worker is not None and self._mission_worker.is_running and self._progress is not None:
            return self._short(self._progress() or self._mission_line)
        start_s = self._history.first_flight_s
        clock = "" if start_s is None else f"  {now_ns * 1e-9 - start_s:.0f} s"
        return f"{self._mission_line}{clock if self._mission_line == 'mission flies' else ''}"

    def _short(self, text: str) -> str:
        """``all`` for the list of all vehicles: it is what people write, and it fits."""
        names = self.fleet.enabled_names
        return text.replace(",".join(names), "all") if len(names) > 1 else text

    def _write_new_events(self, state: FleetState) -> None:
        fresh: list[LoggedEvent] = []
        for logged in reversed(state.events):
            if logged is self._last_event:
                break
            fresh.append(logged)
        for logged in reversed(fresh):
            event = logged.event
            if event.severity == "debug":
                continue
            vehicle = "" if event.vehicle == "ground" else event.vehicle
            stamp = self.time_text(logged.received_ns)
            if event.order_outcome in look.PHASE_SIGNS:
                sign, colour = look.PHASE_SIGNS[event.order_outcome]
                self._event_log.add(sign, colour, self._short(event.sentence), vehicle=vehicle, stamp=stamp)
            else:
                sentence = self._short(event.sentence)
                self._event_log.write(sentence, severity=event.severity, vehicle=vehicle, stamp=stamp)
        if state.events:
            self._last_event = state.events[-1]

    def time_text(self, received_ns: int) -> str:
        """When something was heard, for the event log: the time of day."""
        ago_s = (self.client.now_ns() - received_ns) * 1e-9
        return time.strftime("%H:%M:%S", time.localtime(time.time() - ago_s))

    async def _fly(self, mission: Mission) -> object:
        verdict = await mission()
        sentences = getattr(verdict, "sentences", None) or str(verdict).splitlines()
        is_good = bool(getattr(verdict, "is_passed", getattr(verdict, "passed", True)))
        status = getattr(verdict, "exit_status", None)
        self.status = status if isinstance(status, int) else 0 if is_good else 1
        self._show_verdict([look.clean(sentence) for sentence in sentences], self.status == 0)
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

    # -- orders ----------------------------------------------------------------------------------------------------

    async def on_order_line_given(self, message: OrderLine.Given) -> None:
        """An order was written."""
        await self.give(message.text)

    async def give(self, order: Intent | str) -> None:
        """Send an order and show each vehicle's answer; a misspelt one is a sentence."""
        line = self._result_line
        try:
            handle = await self.client.submit(order)
        except OrderError as error:
            line.show_sentence(str(error))
            self._event_log.write(f"Not sent: {look.clean(order, 60)}. {error}", severity="warning")
            return
        self._handle = handle
        self._event_log.add("→", look.CALM, self._short(str(handle.intent)))
        line.show_order(handle, self._short(str(handle.intent)))
        handle.add_listener(lambda result: self._take_result(handle, result))
        for result in handle.results.values():
            if result.phase == "refused":
                self._log_result(result)

    def _take_result(self, handle: OrderHandle, result: VehicleResult) -> None:
        if handle is self._handle and self.is_running:
            self._result_line.show_order(handle, self._short(str(handle.intent)))
        if result.phase in ("refused", "no answer", "direct"):  # the other ends come as the vehicle's own events
            self._log_result(result)

    def _log_result(self, result: VehicleResult) -> None:
        sign, colour = look.PHASE_SIGNS[result.phase]
        self._event_log.add(sign, colour, result.sentence or result.phase, vehicle=result.vehicle)

    async def action_order_all(self, verb: str) -> None:
        """Land or hold everybody, from every screen, without a question: it only makes things safer."""
        await self.give(Intent("land" if verb == "land" else "hold", self.fleet.enabled_names))

    async def action_kill(self, key: str) -> None:
        """First press arms the key for the vehicle under the cursor, the same key within a second kills."""
        now_s = self.client.now_ns() * 1e-9
        name = self._fleet_table.selected
        if name is None:
            return
        armed = self._kill
        self._kill = None
        if armed is not None and armed[:2] == (key, name) and now_s - armed[2] <= KILL_WINDOW_S:
            self._event_log.add("✖", look.KILL, f"KILL {name}")
            await self.give(Intent("kill", (name,)))
        else:
            self._kill = (key, name, now_s)
        self.refresh_fleet()

    # -- moving about ----------------------------------------------------------------------------------------------

    def action_order_line(self) -> None:
        """Write an order."""
        self._order_line.focus()

    def action_help(self) -> None:
        """Show the keys."""
        self.push_screen(HelpScreen())

    def action_acknowledge(self) -> None:
        """All alarms that hold have been seen; they stay in the list."""
        self.alarms.acknowledge()
        self.refresh_fleet()

    def action_alarms(self) -> None:
        """Everything that is wrong, with advice."""
        self.push_screen(AlarmsScreen(self.alarms))
        self.refresh_fleet()

    async def action_back(self) -> None:
        """Back to the fleet."""
        self._fleet_table.focus()

    def action_zoom(self, factor: float) -> None:
        """Zoom the plan."""
        self._plan.change_zoom(factor)

    def action_look_back(self, pages: int) -> None:
        """Scroll the events."""
        self._event_log.look_back(pages)

    def action_verdict(self) -> None:
        """Hide or show the verdict."""
        box = self._verdict
        if box.border_title:
            self._open_verdict(not box.display)

    def _open_verdict(self, is_open: bool) -> None:
        """It stands where the events are, which tell the same: the plan keeps its room."""
        self._verdict.display, self._event_log.display = is_open, not is_open

    async def action_leave(self) -> None:
        """Quit; a flying fleet is asked about first."""
        flying = self.client.state.airborne_names
        if not flying:
            is_cut_short = self._mission_worker is not None and self._mission_worker.is_running
            self.exit(INTERRUPTED if is_cut_short else self.status)
        elif not isinstance(self.screen, QuitScreen):
            self.push_screen(QuitScreen(flying), self._land_and_leave)

    async def _land_and_leave(self, is_wanted: bool | None) -> None:
        if is_wanted:
            is_cut_short = self._mission_worker is not None and self._mission_worker.is_running
            self._stop_mission()
            self._leaving = INTERRUPTED if is_cut_short else self.status
            await self.action_order_all("land")

    async def action_interrupt(self) -> None:
        """Ctrl-C: land, then leave; a second one leaves at once."""
        if self._leaving is not None or not self.client.state.airborne_names:
            self.exit(INTERRUPTED)
            return
        self._stop_mission()
        self._leaving = INTERRUPTED
        await self.action_order_all("land")
        self._event_log.write("Landing all, then leaving. Ctrl-C again leaves at once.", severity="warning")

    def _stop_mission(self) -> None:
        if self._mission_worker is not None:
            self._mission_worker.cancel()


async def run_console(
    fleet: FleetConfig,
    client: ConsoleClient,
    *,
    mission: Mission | None = None,
    title: str = "",
    progress: Callable[[], str] | None = None,
    has_bell: bool = False,
) -> int:
    """Show the console until the operator quits.

    Args:
        fleet: the fleet file.
        client: started or about to be; the console says whom it waits for.
        mission: flies the mission and returns its verdict (``sentences``; ``exit_status`` or ``is_passed`` if any).
        title: what stands at the top.
        progress: one line about where the mission is, asked ten times a second.
        has_bell: ring the terminal's bell for every new alarm.

    Returns:
        The verdict's exit status; 0 without a mission; 130 when the operator cut it short.
    """
    status = await ConsoleApp(
        fleet, client, mission=mission, title=title, progress=progress, has_bell=has_bell
    ).run_async()
    return 0 if status is None else status
