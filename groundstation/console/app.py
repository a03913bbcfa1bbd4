"""The console's app: creates the objects that do the work, and connects them with keys.

The app itself decides little. :class:`OrderEntry` takes orders, :class:`MissionWorker` flies the
mission, :class:`Shutdown` ends the console, and every panel draws itself. The app defines which key
calls which of them. Eight times a second it passes the fleet's state to all panels and to the
screen in front.
"""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable, Sequence
from typing import ClassVar

from textual import events
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.driver import Driver
from textual.filter import LineFilter
from textual.screen import ModalScreen
from textual.widgets import Input
from textual.worker import Worker

from groundstation.alarms.alarms import Alarms
from groundstation.console.clients import ConsoleClient
from groundstation.console.history import History
from groundstation.console.mission_worker import MissionWorker
from groundstation.console.order_entry import OrderEntry
from groundstation.console.panel_sizes import (
    LOW,
    NARROW,
    SHORT,
    TIGHT,
    is_cramped,
    largest_verdict_height,
    panel_sizes,
)
from groundstation.console.panels import Panels
from groundstation.console.priority_keys import TerminalHooks, with_hooks
from groundstation.console.screens.alarms_screen import AlarmsScreen
from groundstation.console.screens.countdown_screen import CountdownScreen
from groundstation.console.screens.dialogs import HelpScreen
from groundstation.console.screens.live import Dialog, LiveScreen
from groundstation.console.screens.vehicle_screen import VehicleScreen
from groundstation.console.shutdown import Shutdown
from groundstation.console.terminal_filters import TerminalFilters
from groundstation.console.theme import FAINT, PHASE_SIGNS, SEVERITY_SIGNS
from groundstation.console.widgets.event_log import EventEntry
from groundstation.console.widgets.lines import Lines
from groundstation.console.widgets.order_line import OrderLine
from groundstation.fleet.state import FleetState, LoggedEvent
from groundstation.missions.mission_orders import (
    CountdownQuestion,
    MissionCall,
    MissionJudge,
    MissionOrders,
)
from groundstation.missions.runner import MissionRun
from groundstation.orders.forecast_process import Forecaster
from groundstation.orders.intents import Verb
from onboard.bus.schema import LOCATE
from onboard.config.fleet import FleetConfig

REFRESH_S = 0.125
# Time after which Python switches to another thread that waits; the default is 5 ms. The thread
# that reads the terminal sends the emergency orders, and must not wait until the loop has drawn.
SWITCH_S = 0.0005


class ConsoleApp(App[int]):
    """One screen for one fleet.

    Args:
        client: client of the fleet, or of a recorded flight.
        mission: function that flies a mission in a worker; the verdict stays until the operator
            quits.
        connect: function that opens the bus in a worker.
        title: text at the top; by default the fleet's name.
        progress: function that returns one line about the mission.
        run: run of the mission, which written orders can pause and step through.
        judge: function that returns the verdict of a mission that is started here; None: the
            verdict is computed from the live state.
        has_bell: whether to ring the terminal's bell for every new alarm.
        forecaster: computes previews; None: every order is sent at once.
    """

    CSS_PATH = "style.tcss"
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+l,f9", "order_all('land')", "LAND ALL", priority=True),
        Binding("ctrl+o,f8", "order_all('hold')", "HOLD ALL", priority=True),
        Binding("f7", "order('land')", "land the selected", priority=True),
        Binding("f6", "order('hold')", "hold the selected", priority=True),
        Binding("f2", "order('arm')", "arm the selected"),
        Binding("f3", "order('takeoff')", "take off"),
        Binding("f4", "begin_order('move')", "move the selected"),
        Binding("f5", "begin_order('formation')", "formation"),
        Binding("w", "order('locate')", "locate"),
        Binding("p", "order_paths('pause')", "pause the show"),
        Binding("r", "order_paths('resume')", "resume the show"),
        Binding("E", "order_paths('skip')", "skip to the end of the show"),
        Binding("H", "order_paths('bring_home')", "bring all home"),
        Binding("x", "stop_countdown", "stop the countdown"),
        Binding("f12", "kill('f12')", "KILL", priority=True),
        Binding("ctrl+backslash", "kill('ctrl+backslash')", "KILL", priority=True),
        Binding("ctrl+y", "answer_request('give')", "give control", priority=True),
        Binding("ctrl+n", "answer_request('keep')", "keep control", priority=True),
        # Priority, so that the line has the focus before the next key is read: without it the
        # letters after a quickly typed colon would act as keys of the fleet table.
        Binding("colon", "order_line", "order", priority=True),
        Binding("ctrl+c", "interrupt", "land and leave", priority=True),
        Binding("ctrl+q", "leave", "quit", priority=True),
        Binding("q", "leave", "quit"),
        Binding("v", "verdict", "verdict"),
        Binding("t", "theme", "light or dark"),
        Binding("question_mark", "help", "help"),
        Binding("escape", "back", "back"),
        Binding("plus,equals_sign", "zoom(1.5)", "zoom in"),
        Binding("minus", "zoom(0.6666666667)", "zoom out"),
        Binding("0", "whole_fence", "whole fence"),
        Binding("pageup", "scroll_events(-1)", "earlier events"),
        Binding("pagedown", "scroll_events(1)", "later events"),
        Binding("a", "acknowledge", "acknowledge alarms"),
        Binding("A", "alarms", "alarms"),
        Binding("enter", "vehicle", "everything about one vehicle"),
    ]

    def __init__(
        self,
        fleet: FleetConfig,
        client: ConsoleClient,
        *,
        mission: MissionCall | None = None,
        connect: MissionCall | None = None,
        title: str = "",
        progress: Callable[[], str] | None = None,
        run: MissionRun | None = None,
        judge: MissionJudge | None = None,
        has_bell: bool = False,
        forecaster: Forecaster | None = None,
    ) -> None:
        # Set before Textual's own `__init__`, which reads the class of the driver.
        self.terminal = TerminalHooks(on_key=lambda key: self.orders.send_urgent(key))
        super().__init__()

        self.fleet = fleet
        self.client = client
        self.has_bell = has_bell
        self.fleet_title = title or fleet.fleet.name

        self.alarms = Alarms(fleet)
        self.history = History(fleet.fleet.battery_land_pct / 100.0)
        self.panels = Panels(fleet, self.history)
        self.filters = TerminalFilters()

        self.orders = OrderEntry(
            self, fleet, client, self.panels, forecaster=forecaster, refresh=self.refresh_fleet
        )
        self.panels.order_line.on_order = self.orders.take_line
        self.mission = MissionWorker(
            self, self.panels, mission=mission, connect=connect, progress=progress
        )
        self.orders.missions = MissionOrders(
            client,
            self.mission.begin,
            judge,
            run,
            ask=None if forecaster is None else self._ask_countdown,
            latch=self.orders.latch,
        )
        self.shutdown = Shutdown(
            app=self,
            fleet=fleet,
            client=client,
            orders=self.orders,
            mission=self.mission,
            terminal=self.terminal,
            table=self.panels.table,
            warn=self._warn,
        )

        self._newest_event: LoggedEvent | None = None  # newest event that is in the log

    def compose(self) -> ComposeResult:
        """All panels."""
        yield from self.panels.compose()

    def on_mount(self) -> None:
        """Start the refresh, then the mission."""
        self.panels.table.focus()

        name = self.fleet.fleet.name
        count = len(self.fleet.enabled_names)
        self.panels.events.add(f"Fleet '{name}': {count} vehicles. Press ? for help.")

        self.set_interval(REFRESH_S, self.refresh_fleet)

        if not self.is_headless:
            self.shutdown.catch_signals()
            self.orders.warm_up()
            sys.setswitchinterval(SWITCH_S)

            # A garbage collection of all loaded objects would delay the reaction to a key. So they
            # are collected once now, and excluded from later collections.
            gc.collect()
            gc.freeze()

        self.mission.start()

    async def on_unmount(self) -> None:
        """End the forecast processes and remove the signal handlers."""
        self.shutdown.release_signals()
        await self.orders.stop()

    async def run_to_end(self) -> int:
        """Show the console until the operator quits.

        Returns:
            The exit status: the verdict's, 0 without a mission, 130 if the operator ended the
                mission early.
        """
        status = await self.run_async()
        if status is None:
            return 0
        return status

    # -- the terminal ------------------------------------------------------------------------------

    def get_driver_class(self) -> type[Driver]:
        """Return a driver that handles emergency keys at once."""
        return with_hooks(super().get_driver_class(), self.terminal)

    def get_line_filters(self) -> Sequence[LineFilter]:
        """Return the filters of this terminal."""
        return self.filters.active(has_colour=not self.no_color)

    def on_resize(self, event: events.Resize) -> None:
        """Share the new size among the panels."""
        self._arrange(event.size.width, event.size.height)

    def on_lines_alone(self, message: Lines.Alone) -> None:
        """Give a panel the whole terminal, or share it again."""
        self._arrange(*self.size, message.name)

    def _arrange(self, width: int, height: int, alone: str | None = None) -> None:
        """Share the terminal among the panels.

        `alone` is the panel that gets all the room, or empty for none; None keeps the present one.
        """
        screen = self.screen_stack[0]
        if alone is None:
            alone = _enlarged_panel(screen.classes)

        # The style sheet hides or narrows panels by these classes.
        screen.set_class(height < LOW, "low")
        screen.set_class(width < NARROW, "narrow")
        screen.set_class(height < TIGHT, "tight")
        screen.set_class(height < SHORT, "short")

        table_height, plan_width = panel_sizes(
            width=width,
            height=height,
            vehicles=len(self.client.state.vehicles),
            fence=self.fleet.fleet.geofence_m,
            alone=alone,
        )
        self.panels.table.styles.height = table_height
        cramped = False
        if isinstance(table_height, int) and not alone:
            cramped = is_cramped(height, table_height)
        screen.set_class(cramped, "cramped")

        verdict_height = None
        if alone != "verdict":
            verdict_height = largest_verdict_height(height, table_height)
        self.panels.verdict.styles.max_height = verdict_height
        screen.set_class(self.mission.is_verdict_shown and verdict_height != 0, "judged")
        self.panels.plan.styles.width = plan_width

    # -- the picture -------------------------------------------------------------------------------

    def refresh_fleet(self) -> None:
        """Draw the present state of the fleet."""
        if self.shutdown.is_hung_up:
            return

        state = self.client.state
        now_ns = self.client.now_ns()
        panels = self.panels

        self.history.add(state, now_ns)
        self._log_new_events(state)

        panels.table.show(state, now_ns, self.orders.latch.killed)
        panels.plan.show(state, now_ns, panels.table.selected, panels.table.marked)
        panels.separation.show(state, now_ns)
        self._show_title(state, now_ns)

        self.alarms.update(state, now_ns)
        if self.has_bell and self.alarms.has_new:
            self.bell()

        self.orders.update()
        self.mission.note_flight(is_flying=bool(state.airborne_names))
        self.mission.count_hidden_lines()

        front = self.screen_stack[-1] if self.screen_stack else None
        if isinstance(front, LiveScreen):
            front.show_fleet(state, now_ns)
        elif isinstance(front, Dialog):
            front.show_fleet()

        status_bars = [panels.status]
        if isinstance(front, LiveScreen | Dialog):
            status_bars.append(front.status)
        for bar in status_bars:
            bar.show(self.alarms, now_ns, self.orders.armed_kill, can_order=self.orders.can_order)

        self.shutdown.update()

    def _show_title(self, state: FleetState, now_ns: int) -> None:
        right_text = self.shutdown.text
        if not right_text:
            right_text = self.orders.shorten(self.mission.text)

        self.panels.title.show(
            title=self.fleet_title,
            fresh=sum(1 for view in state.vehicles.values() if view.is_fresh(now_ns)),
            vehicles=len(state.vehicles),
            flying=len(state.airborne_names),
            flight_s=self.history.flight_s(now_ns),
            right=right_text,
        )

    def _log_new_events(self, state: FleetState) -> None:
        entries = []
        for logged in state.events_after(self._newest_event):
            if logged.event.severity == "debug":
                continue
            if logged.event.code in LOCATE:
                self.panels.table.blink(logged.event.vehicle)
            entries.append(self._log_entry(logged))
        self.panels.events.extend(entries)

        if state.events:
            self._newest_event = state.events[-1]

    def _log_entry(self, logged: LoggedEvent) -> EventEntry:
        event = logged.event

        sign = PHASE_SIGNS.get(event.order_outcome)
        if sign is None:
            sign = SEVERITY_SIGNS.get(event.severity, SEVERITY_SIGNS["info"])

        vehicle = event.vehicle
        if vehicle == "ground":
            vehicle = ""  # sentences of this ground itself are shown without a name
        sentence = self.orders.shorten(event.sentence)
        stamp = self.time_text(logged.received_ns)
        return EventEntry.of(sentence, sign, vehicle=vehicle, stamp=stamp)

    def forget_events(self) -> None:
        """Empty the event log; events that are still in the fleet's state are added again."""
        self.panels.events.forget()
        self._newest_event = None

    def _warn(self, sentence: str) -> None:
        self.panels.events.add(sentence, SEVERITY_SIGNS["warning"])

    def time_text(self, received_ns: int) -> str:
        """Return the time of day at which something was received, for the event log."""
        age_s = (self.client.now_ns() - received_ns) * 1e-9
        return time.strftime("%H:%M:%S", time.localtime(time.time() - age_s))

    # -- orders ------------------------------------------------------------------------------------

    @property
    def is_writing(self) -> bool:
        """Whether the operator is typing a text, so that letters do not act as keys."""
        return isinstance(self.focused, Input) or self.panels.table.is_writing

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Let the colon be a letter in texts, and disable its key while a dialog is open."""
        if action == "order_line" and (self.is_writing or isinstance(self.screen, ModalScreen)):
            return False
        return super().check_action(action, parameters)

    def on_input_changed(self, message: Input.Changed) -> None:
        """Show the grammar of the order that is being written, unless it was given meanwhile."""
        line = self.panels.order_line
        if message.value == line.value and message.value != line.refused:
            self.orders.show_usage(message.value)

    def on_order_line_completions(self, message: OrderLine.Completions) -> None:
        """Show the words with which the order line may continue."""
        self.panels.results.show_sentence("  ".join(message.words), FAINT)

    async def action_order_all(self, verb: Verb) -> None:
        """Land or hold all vehicles."""
        await self.orders.order_all(verb, is_by_key=True)

    async def action_order_paths(self, verb: Verb) -> None:
        """Give an order to all vehicles that follow paths: pause, resume, skip or bring home."""
        await self.orders.order_paths(verb)

    async def action_order(self, verb: Verb) -> None:
        """Order something for the selected vehicles."""
        await self.orders.order_selected(verb)

    def action_begin_order(self, verb: Verb) -> None:
        """Begin to write an order for the selected vehicles."""
        self.orders.begin_line(verb)

    def action_order_line(self) -> None:
        """Begin to write an order."""
        self.orders.open_line()

    async def action_kill(self, key: str) -> None:
        """Kill the vehicle under the cursor at the second press."""
        await self.orders.kill(key)

    def action_answer_request(self, answer: str) -> None:
        """Give control to the ground that requests it, or keep it."""
        self.orders.answer_request(answer)

    def action_stop_countdown(self) -> None:
        """End the countdown without starting."""
        if self.orders.missions is not None:
            sentence = self.orders.missions.stop_countdown()
            self.panels.results.show_sentence(sentence)

    def _ask_countdown(
        self, question: Callable[[], CountdownQuestion], begin: Callable[[], None]
    ) -> None:
        """Show the question before a countdown."""

        def begin_if_accepted(is_accepted: bool | None) -> None:
            if is_accepted:
                begin()

        self.push_screen(CountdownScreen(question, self.panels.table), begin_if_accepted)

    # -- mission and leaving -----------------------------------------------------------------------

    def on_worker_state_changed(self, event: Worker.StateChanged) -> None:
        """Show why the mission or the connection has failed."""
        self.mission.worker_changed(event)

    def action_verdict(self) -> None:
        """Show the mission's verdict in its box, then alone, then not at all."""
        self.mission.show_next_verdict_view()

    def action_leave(self) -> None:
        """Quit, after a question if vehicles fly."""
        self.shutdown.quit()

    async def action_interrupt(self) -> None:
        """Land all and quit; if called a second time, quit at once."""
        await self.shutdown.interrupt()

    # -- views -------------------------------------------------------------------------------------

    def action_help(self) -> None:
        """Show the keys."""
        self.push_screen(HelpScreen(table=self.panels.table))

    def action_theme(self) -> None:
        """Change between dark and light."""
        self.filters.is_light = not self.filters.is_light

        for screen in self.screen_stack:
            screen.refresh()
            for widget in screen.query("*"):
                widget.refresh()

    def action_acknowledge(self) -> None:
        """Acknowledge all present alarms; they stay in the list."""
        self.alarms.acknowledge()
        self.refresh_fleet()

    def action_alarms(self) -> None:
        """Show all alarms with advice."""
        self.push_screen(AlarmsScreen(self.alarms))
        self.refresh_fleet()

    def action_vehicle(self) -> None:
        """Show everything about the vehicle under the cursor."""
        table = self.panels.table
        if table.selected is not None and len(self.screen_stack) == 1:
            screen = VehicleScreen(
                fleet=self.fleet,
                alarms=self.alarms,
                stream=self.client.tick_stream,
                table=table,
                time_text=self.time_text,
            )
            self.push_screen(screen)
            self.refresh_fleet()

    async def action_back(self) -> None:
        """Go back to the fleet."""
        self.panels.table.focus()

    def action_zoom(self, factor: float) -> None:
        """Zoom the plan."""
        self.panels.plan.change_zoom(factor)

    def action_whole_fence(self) -> None:
        """Show the fleet's part of the fence in the plan, or the whole fence."""
        self.panels.plan.action_whole()

    def action_scroll_events(self, pages: int) -> None:
        """Scroll the events by pages."""
        self.panels.events.scroll_pages(pages)


def _enlarged_panel(classes: frozenset[str]) -> str:
    """Return the id of the panel that has all the room; empty if there is none.

    The screen has the class "only-ID" then.
    """
    for name in classes:
        if name.startswith("only-"):
            return name.removeprefix("only-")
    return ""
