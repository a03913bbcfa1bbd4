"""The console: puts the widgets together and refreshes them eight times a second."""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Callable
from typing import ClassVar

from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import Static

from groundstation.alarms.alarms import Alarms
from groundstation.console import theme
from groundstation.console.history import History
from groundstation.console.layout import LOW, NARROW, rooms
from groundstation.console.order_entry import ConsoleClient
from groundstation.console.screens.alarms import AlarmsScreen
from groundstation.console.screens.dialogs import HelpScreen
from groundstation.console.screens.live import Dialog, LiveScreen
from groundstation.console.screens.vehicle import VehicleScreen
from groundstation.console.shutdown import LeavingApp, Mission
from groundstation.console.widgets.bars import KEYS, VIEW_KEYS, StatusBar, TitleBar
from groundstation.console.widgets.event_log import EventLog
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.lines import Lines
from groundstation.console.widgets.plan_view import PlanView
from groundstation.console.widgets.separation import SeparationView
from groundstation.fleet.state import FleetState, LoggedEvent
from onboard.config.fleet import FleetConfig

REFRESH_S = 0.125
SWITCH_S = 0.0005  # who waits for Python's lock gets it soon: the thread of the emergency keys while the loop draws


class ConsoleApp(LeavingApp):
    """One screen for one fleet. ``mission`` flies in a worker; its verdict stays until the operator quits."""

    CSS_PATH = "style.tcss"
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("question_mark", "help", "help"),
        Binding("colon", "order_line", "order"),
        Binding("escape", "back", "back"),
        Binding("plus,equals_sign", "zoom(1.5)", "zoom in"),
        Binding("minus", "zoom(0.6666666667)", "zoom out"),
        Binding("0", "zoom(0)", "whole fence"),
        Binding("pageup", "look_back(1)", "earlier events"),
        Binding("pagedown", "look_back(-1)", "later events"),
        Binding("a", "acknowledge", "acknowledge alarms"),
        Binding("A", "alarms", "alarms"),
        Binding("enter", "vehicle", "everything about one vehicle"),
    ]

    def __init__(
        self,
        fleet: FleetConfig,
        client: ConsoleClient,
        *,
        mission: Mission | None = None,
        connect: Mission | None = None,
        title: str = "",
        progress: Callable[[], str] | None = None,
        has_bell: bool = False,
        has_preview: bool = True,
    ) -> None:
        super().__init__(fleet, client, mission=mission, connect=connect, progress=progress, has_preview=has_preview)
        self._fleet_title = title or fleet.fleet.name
        self.alarms = Alarms(fleet)
        self.has_bell = has_bell
        self._history = History(fleet.fleet.battery_land_pct / 100.0)
        self._last_event: LoggedEvent | None = None
        # Held here, not looked up: a timer may still come while the screen is being taken apart.
        self._title_bar = TitleBar("title")
        self._fleet_table = FleetTable(fleet, self._history)
        self._plan = PlanView(fleet, self._history)
        self._separation = SeparationView(fleet, self._history)
        self._event_log = EventLog()
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
        yield self._notices
        yield self._result_line
        with Horizontal(id="line"):
            yield Static(" : ", id="prompt", markup=False)
            yield self._order_line
            yield Static("esc leaves ", id="leave", markup=False)
        yield self._status_bar

    def on_mount(self) -> None:
        """Start looking, then flying."""
        self._fleet_table.focus()
        self._event_log.write(
            f"Fleet '{self.fleet.fleet.name}': {len(self.fleet.enabled_names)} vehicles. Press ? for help."
        )
        self.set_interval(REFRESH_S, self.refresh_fleet)
        if not self.is_headless:
            self.catch_signals()
            sys.setswitchinterval(SWITCH_S)
            gc.collect()
            gc.freeze()  # a look at all that was loaded takes as long as a key may take to come to the screen
        self.start_mission()

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
        screen.set_class(height < LOW, "low")
        screen.set_class(width < NARROW, "narrow")
        count = len(self.client.state.vehicles)
        self._fleet_table.styles.height, self._plan.styles.width = rooms(
            width, height, count, self.fleet.fleet.geofence_m, alone
        )

    # -- what is seen ----------------------------------------------------------------------------------------------

    def refresh_fleet(self) -> None:
        """Draw the fleet as it is now."""
        if self.is_hung_up:
            return
        state, now_ns = self.client.state, self.client.now_ns()
        self._history.add(state, now_ns)
        self._write_new_events(state)
        self._fleet_table.show(state, now_ns)
        self._plan.show(state, now_ns, self._fleet_table.selected, self._fleet_table.marked)
        self._separation.show(state, now_ns)
        heard = sum(view.is_fresh(now_ns) for view in state.vehicles.values())
        title = self._title_bar
        title.show(self._fleet_title, heard, len(state.vehicles), len(state.airborne_names), self._mission_text(now_ns))
        self.alarms.update(state, now_ns)
        if self.has_bell and self.alarms.is_news:
            self.bell()
        self.show_notices()
        can_order = self._ordering is not None
        self._status_bar.show(self.alarms, now_ns, self.armed_kill, KEYS if can_order else VIEW_KEYS)
        front = self.screen_stack[-1] if self.screen_stack else None
        if isinstance(front, LiveScreen):
            front.show_fleet(state, now_ns, self.armed_kill, can_order=can_order)
        elif isinstance(front, Dialog):
            front.show_alarms(self.alarms, now_ns, self.armed_kill, can_order=can_order)
        self.leave_when_down()

    def _mission_text(self, now_ns: int) -> str:
        start_s = self._history.first_flight_s
        return self.progress_text("" if start_s is None else f"  {now_ns * 1e-9 - start_s:.0f} s")

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
            if event.code == "identify":
                self._fleet_table.blink(event.vehicle)
            vehicle = "" if event.vehicle == "ground" else event.vehicle
            stamp = self.time_text(logged.received_ns)
            if event.order_outcome in theme.PHASE_SIGNS:
                sign, colour = theme.PHASE_SIGNS[event.order_outcome]
                self._event_log.add(sign, colour, self.short(event.sentence), vehicle=vehicle, stamp=stamp)
            else:
                sentence = self.short(event.sentence)
                self._event_log.write(sentence, severity=event.severity, vehicle=vehicle, stamp=stamp)
        if state.events:
            self._last_event = state.events[-1]

    def time_text(self, received_ns: int) -> str:
        """When something was heard, for the event log: the time of day."""
        ago_s = (self.client.now_ns() - received_ns) * 1e-9
        return time.strftime("%H:%M:%S", time.localtime(time.time() - ago_s))

    # -- moving about ----------------------------------------------------------------------------------------------

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

    def action_vehicle(self) -> None:
        """Everything about the vehicle under the cursor."""
        if self._fleet_table.selected is not None and len(self.screen_stack) == 1:
            self.push_screen(
                VehicleScreen(
                    self.fleet,
                    self.alarms,
                    self.client.tick_stream,
                    selected=lambda: self._fleet_table.selected,
                    move=self._fleet_table.action_cursor,
                    time_text=self.time_text,
                )
            )
            self.refresh_fleet()

    @property
    def chosen(self) -> tuple[str, ...]:
        """Whom keys mean: on its page a vehicle stands alone, whatever is marked in the table behind it."""
        front = self.screen_stack[-1] if self.screen_stack else None
        shown = front.vehicle_name if isinstance(front, VehicleScreen) else None
        return super().chosen if shown is None else (shown,)

    async def action_back(self) -> None:
        """Back to the fleet."""
        self._fleet_table.focus()

    def action_zoom(self, factor: float) -> None:
        """Zoom the plan."""
        self._plan.change_zoom(factor)

    def action_look_back(self, pages: int) -> None:
        """Scroll the events."""
        self._event_log.look_back(pages)


async def run_console(
    fleet: FleetConfig,
    client: ConsoleClient,
    *,
    mission: Mission | None = None,
    connect: Mission | None = None,
    title: str = "",
    progress: Callable[[], str] | None = None,
    has_bell: bool = False,
    has_preview: bool = True,
) -> int:
    """Show the console until the operator quits.

    Args:
        fleet: the fleet file.
        client: started or about to be; the console says whom it waits for.
        mission: flies the mission and returns its verdict (``sentences``; ``exit_status`` or ``is_passed`` if any).
        connect: opens the bus, while the console is on the screen already.
        title: what stands at the top.
        progress: one line about where the mission is, asked at each look.
        has_bell: ring the terminal's bell for every new alarm.
        has_preview: show what arm, take-off and moves lead to before they are sent.

    Returns:
        The verdict's exit status; 0 without a mission; 130 when the operator cut it short.
    """
    app = ConsoleApp(
        fleet,
        client,
        mission=mission,
        connect=connect,
        title=title,
        progress=progress,
        has_bell=has_bell,
        has_preview=has_preview,
    )
    status = await app.run_async()
    return 0 if status is None else status
