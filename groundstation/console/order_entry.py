"""How orders are given: written, by key, with a preview, at once; the kill latch; who operates."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable
from typing import ClassVar, Protocol, runtime_checkable

from textual.binding import Binding, BindingType
from textual.driver import Driver
from textual.screen import Screen

from groundstation.console import theme
from groundstation.console.priority_keys import prompt
from groundstation.console.screens.preview import PreviewScreen
from groundstation.console.terminal_filters import DressedApp
from groundstation.console.theme import CALM, FAINT, KILL
from groundstation.console.widgets.event_log import EventLog
from groundstation.console.widgets.fleet_table import FleetTable
from groundstation.console.widgets.notices import NoticeLines, notices
from groundstation.console.widgets.order_line import CONTROL_ORDERS, OrderLine
from groundstation.console.widgets.results import ResultLine
from groundstation.fleet.control_authority import FORCE_WORD, Control
from groundstation.fleet.state import FleetState
from groundstation.fleet.tick_stream import TickStream
from groundstation.orders.forecast_process import Forecaster
from groundstation.orders.grammar import USAGE, Intent, OrderError, Verb, parse
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.preview import PREVIEWED
from groundstation.orders.result import OrderResult, VehicleResult
from onboard.config.fleet import ConfigError, FleetConfig

KILL_WINDOW_S = 1.0
_AT_ONCE: dict[str, Verb] = {"ctrl+l": "land", "f9": "land", "ctrl+o": "hold", "f8": "hold"}  # for everybody
_ENTER = "enter"


class ConsoleClient(Protocol):
    """What the console needs of :class:`groundstation.client.client.FleetClient`, or of a record."""

    @property
    def tick_stream(self) -> TickStream:
        """The pipeline's values of the vehicle whose page is open."""

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""

    def now_ns(self) -> int:
        """The clock that ages are counted on."""

    async def submit(self, order: Intent | str) -> OrderResult:
        """Send an order; results fill in."""


@runtime_checkable
class OrderingClient(Protocol):
    """What a client has besides, when a fleet is behind it that takes orders."""

    control: Control

    @property
    def state(self) -> FleetState:
        """The fleet as known now."""

    def now_ns(self) -> int:
        """The clock that ages are counted on."""

    def plan(self, order: Intent | str) -> PlannedOrder:
        """Plan an order and check it; nothing is sent."""

    def check_again(self, planned: PlannedOrder) -> PlannedOrder:
        """Check a planned order against the fleet as it is now."""

    def send(self, planned: PlannedOrder) -> OrderResult:
        """Send a planned order from any thread; results fill in."""

    def submit_now(self, order: Intent | str) -> OrderResult:
        """Send an order from any thread; results fill in."""


class OrderingApp(DressedApp):
    """An app that gives orders; :class:`groundstation.console.app.ConsoleApp` puts the widgets on the screen."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("ctrl+l,f9", "order_all('land')", "LAND ALL", priority=True),
        Binding("ctrl+o,f8", "order_all('hold')", "HOLD ALL", priority=True),
        Binding("f7", "order_chosen('land')", "land the chosen", priority=True),
        Binding("f6", "order_chosen('hold')", "hold the chosen", priority=True),
        Binding("f2", "order_chosen('arm')", "arm the chosen"),
        Binding("f3", "order_chosen('takeoff')", "take off"),
        Binding("f4", "write_order('move')", "move the chosen"),
        Binding("f5", "write_order('formation')", "formation"),
        Binding("w", "order_chosen('locate')", "locate"),
        Binding("f12", "kill('f12')", "KILL", priority=True),
        Binding("ctrl+backslash", "kill('ctrl+backslash')", "KILL", priority=True),
        Binding("ctrl+y", "give_control", "give control", priority=True),
        Binding("ctrl+n", "keep_control", "keep control", priority=True),
    ]
    fleet: FleetConfig
    client: ConsoleClient
    _fleet_table: FleetTable
    _event_log: EventLog

    def __init__(self, fleet: FleetConfig, client: ConsoleClient, *, has_preview: bool = True) -> None:
        super().__init__()
        self.fleet, self.client = fleet, client
        self._ordering = client if isinstance(client, OrderingClient) else None
        self._forecaster = Forecaster() if has_preview and self._ordering is not None else None
        self._early: deque[OrderResult] = deque()  # of keys whose turn comes
        self._kill: tuple[str, tuple[str, ...], float] | None = None
        self._is_warm = False
        self._killed: set[str] = set()
        self._written = ""  # the order that is being taken from the order line
        self._handle: OrderResult | None = None
        self._result_line = ResultLine("result")
        self._order_line = OrderLine(fleet)
        self._notices = NoticeLines()

    @property
    def control(self) -> Control | None:
        """Who operates; None where there is nobody to order, as in a replay."""
        return None if self._ordering is None else self._ordering.control

    @property
    def armed_kill(self) -> str | None:
        """Whom the next press of the kill key stops; None when it would only arm."""
        if self._kill is not None and self.client.now_ns() * 1e-9 - self._kill[2] > KILL_WINDOW_S:
            self._kill = None
        return None if self._kill is None else self.short(",".join(self._kill[1]))

    @property
    def chosen(self) -> tuple[str, ...]:
        """Whom keys mean: the marked vehicles, else the one under the cursor."""
        table = self._fleet_table
        return table.marked or ((table.selected,) if table.selected is not None else ())

    def short(self, text: str) -> str:
        """``all`` for the list of all vehicles: it is what people write, and it fits."""
        names = self.fleet.enabled_names
        return text.replace(",".join(names), "all") if len(names) > 1 else text

    def show_notices(self) -> None:
        """Bring the lines that stay up to date."""
        if self.control is not None:
            self.control.update(self.client.state)
        self._notices.show(notices(tuple(sorted(self._killed)), self.control))

    async def on_unmount(self) -> None:
        """No process is left behind."""
        if self._forecaster is not None:
            await self._forecaster.stop()

    # -- written orders ----------------------------------------------------------------------------------------------

    async def on_order_line_given(self, message: OrderLine.Given) -> None:
        """An order was written: the line is left, and comes back with it when it was refused."""
        self._order_line.action_leave()
        self._written = message.text
        words = message.text.split()
        if words[:2] in (["take", "control"], ["give", "control"], ["keep", "control"]) and len(words) <= 3:
            self._talk_about_control(words)
        elif words[0] == "reset":
            self._reset(" ".join(words[1:]))
        else:
            await self.order(message.text, is_written=True)
        self._written = ""

    def on_order_line_choices(self, message: OrderLine.Choices) -> None:
        """Tab found several ways to go on."""
        self._result_line.show_sentence("  ".join(message.words), FAINT)

    def on_input_changed(self, message: OrderLine.Changed) -> None:
        """While an order is written its grammar stands above it."""
        if message.input is not self._order_line or not message.value.strip():
            return
        first = message.value.split()[0].lower()
        verb = next((verb for verb in USAGE if verb == first), None)
        if verb is not None:
            self._result_line.show_sentence(USAGE[verb], FAINT)
        self.warm_up()

    def warm_up(self) -> None:
        """Have the forecast's process ready before it is needed."""
        if self._forecaster is not None and not self._is_warm:
            self._is_warm = True  # once: a start that is cut short by the next key would leave a process behind
            self.run_worker(self._forecaster.start(), group="warm")

    async def order(self, order: Intent | str, *, is_written: bool = False) -> None:
        """An operator's order: a question first where something could go wrong, at once where it makes things safer."""
        try:
            intent = parse(order, self.fleet) if isinstance(order, str) else order
        except OrderError as error:
            self._not_sent(str(order), str(error))
            return
        latched = sorted(self._killed.intersection(intent.vehicles))
        if intent.verb in PREVIEWED and latched:
            who, them = ",".join(latched), "it" if len(latched) == 1 else "them"
            self._not_sent(str(intent), f"{who} was killed. Look at {them}, then write: reset {who}")
        elif intent.verb == "kill" and is_written and not self._is_kill_confirmed(_ENTER, intent.vehicles):
            self._order_line.take_back(str(intent))
        elif intent.verb in PREVIEWED and self._forecaster is not None and self._ordering is not None:
            refusal = self._ordering.control.refusal(intent.verb)
            if refusal is not None:
                self._not_sent(str(intent), refusal)
                return
            screen = PreviewScreen(self.fleet, self._ordering, intent, self._forecaster, self.short)
            self.push_screen(screen, self._answered)
        else:
            await self.give(intent)

    async def _answered(self, planned: PlannedOrder | None) -> None:
        if planned is not None and self._ordering is not None:
            await self.give(planned.intent, self._ordering.send(planned))

    async def give(self, order: Intent | str, sent: OrderResult | None = None) -> None:
        """Send an order at once and show each vehicle's answer; a misspelt one is a sentence.

        ``sent``: it has left already.
        """
        try:
            handle = sent or await self.client.submit(order)
        except (OrderError, RuntimeError) as error:  # RuntimeError: the bus is not open yet, or not any more
            self._not_sent(str(order), str(error))
            return
        self._handle = handle
        if handle.intent.verb == "kill" and handle.planned.orders:  # it has left, whatever becomes of it
            self._event_log.add("✖", KILL, f"KILL {','.join(handle.planned.orders)}")
            self._killed.update(handle.planned.orders)
            self.show_notices()
        self._event_log.add("→", CALM, self.short(str(handle.intent)))
        self._result_line.show_order(handle, self.short(str(handle.intent)))
        handle.add_listener(lambda result: self._take_result(handle, result))
        for result in handle.results.values():
            if result.phase == "refused":
                self._log_result(result)

    def _not_sent(self, order: str, why: str) -> None:
        if self._written:
            self._order_line.take_back(self._written)
        self._result_line.show_sentence(why)
        self._event_log.write(f"Not sent: {theme.clean(self.short(order), 60)}. {why}", severity="warning")

    def _take_result(self, handle: OrderResult, result: VehicleResult) -> None:
        if handle is self._handle and self.is_running:
            self._result_line.show_order(handle, self.short(str(handle.intent)))
        if result.phase in ("refused", "no answer", "direct"):  # the other ends come as the vehicle's own events
            self._log_result(result)

    def _log_result(self, result: VehicleResult) -> None:
        sign, colour = theme.PHASE_SIGNS[result.phase]
        self._event_log.add(sign, colour, result.sentence or result.phase, vehicle=result.vehicle)

    # -- keys --------------------------------------------------------------------------------------------------------

    def get_driver_class(self) -> type[Driver]:
        """A driver that does not let an emergency key wait."""
        return prompt(super().get_driver_class())

    def hear_key(self, key: str) -> None:
        """Send what lands or holds everybody, on the thread that reads the terminal; the key's turn comes later."""
        verb = _AT_ONCE.get(key)
        if verb is None or self._ordering is None or not self.fleet.enabled_names:
            return
        with contextlib.suppress(OrderError, RuntimeError):  # told when the key's turn comes
            self._early.append(self._ordering.submit_now(Intent(verb, self.fleet.enabled_names)))

    async def action_order_all(self, verb: Verb) -> None:
        """Land or hold everybody, from every screen, without a question: it only makes things safer."""
        sent = self._early.popleft() if self._early else None
        if self.fleet.enabled_names:
            await self.give(Intent(verb, self.fleet.enabled_names), sent)
        else:
            self._not_sent(f"{verb} all", "This fleet has nobody to order: no vehicle is enabled in its file.")
        self._drop_question()  # only now: the order was not to wait for the screen

    async def action_order_chosen(self, verb: Verb) -> None:
        """An order for the marked vehicles, or the one under the cursor."""
        if not self.chosen:
            self._result_line.show_sentence("No vehicle is chosen: move the cursor to one, or mark some with space.")
            return
        if verb in ("land", "hold"):
            self._drop_question()
        height_m = 1.0 if verb == "takeoff" else None
        await self.order(Intent(verb, self.chosen, height_m=height_m))

    def action_write_order(self, verb: Verb) -> None:
        """Begin to write an order for the chosen vehicles; the numbers are the operator's."""
        who = self.short(",".join(self.chosen))
        if verb == "formation":
            name = next(iter(self.fleet.formations), "")
            self._order_line.write(f"formation {name} {who} " if len(self.chosen) > 1 else f"formation {name} ")
        else:
            self._order_line.write(f"{verb} {who} ")
        self._fleet_table.keep_marks()

    def action_order_line(self) -> None:
        """Write an order."""
        self._order_line.focus()
        self.warm_up()

    async def action_kill(self, key: str) -> None:
        """First press arms the key for one vehicle, the same key within a second kills it."""
        name = getattr(self.screen, "vehicle_name", None) or self._fleet_table.selected
        if isinstance(name, str) and self._is_kill_confirmed(key, (name,)):
            await self.give(Intent("kill", (name,)))

    def _is_kill_confirmed(self, key: str, names: tuple[str, ...]) -> bool:
        is_armed = self.armed_kill is not None  # forgets an old press
        armed, self._kill = self._kill, None
        if is_armed and armed is not None and armed[:2] == (key, names):
            self._drop_question()
            return True
        self._kill = (key, names, self.client.now_ns() * 1e-9)
        if key == _ENTER:
            self._result_line.show_sentence("Enter again within 1 s stops the motors: they fall.", KILL)
        self.refresh_fleet()
        return False

    def refresh_fleet(self) -> None:
        """Draw the fleet as it is now."""
        raise NotImplementedError

    def _drop_question(self) -> None:
        """An order that makes things safer ends whatever was about to be sent."""
        screen: Screen[object] = self.screen
        if isinstance(screen, PreviewScreen):
            screen.action_drop()

    def _reset(self, who: str) -> None:
        try:
            names = self.fleet.select(who) if who else tuple(self._killed)
        except ConfigError as error:
            self._not_sent(f"reset {who}", str(error))
            return
        freed = self._killed.intersection(names)
        self._killed -= freed
        who = ", ".join(sorted(freed))
        sentence = f"{who} may be ordered again." if freed else "Nobody was killed from here."
        self._result_line.show_sentence(sentence, FAINT)
        self.show_notices()

    # -- control -----------------------------------------------------------------------------------------------------

    def action_give_control(self) -> None:
        """Hand over to who asks."""
        if self.control is not None and self.control.requester is not None:
            self._talk_about_control(["give", "control"])

    def action_keep_control(self) -> None:
        """Say no to who asks."""
        if self.control is not None and self.control.requester is not None:
            self._talk_about_control(["keep", "control"])

    def _talk_about_control(self, words: list[str]) -> None:
        control, word = self.control, words[2] if len(words) > 2 else ""
        if control is None:
            self._result_line.show_sentence("There is nobody to control here.")
            return
        if word not in ("", FORCE_WORD) or (word and words[0] != "take"):
            self._not_sent(" ".join(words), f"Write one of: {', '.join(CONTROL_ORDERS)}.")
            return
        acts: dict[str, Callable[[], str]] = {
            "take": lambda: control.take(word),
            "give": control.hand_over,
            "keep": control.keep,
        }
        sentence = acts[words[0]]()
        self._result_line.show_sentence(sentence, CALM)
        self._event_log.write(sentence)
        self.show_notices()
