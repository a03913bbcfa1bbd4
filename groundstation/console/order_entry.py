"""Orders from the order line and the keys: parsed, previewed or sent, and their results shown.

There are three kinds of order:

* Orders that make a flight safer (land, hold) are sent at once, from every screen. LAND ALL and
  HOLD ALL are even sent by the thread that reads the terminal; the screen shows them when the event
  loop handles the key.
* Orders that could go wrong (arm, take-off, move, formation) open a preview first. The order that
  the preview has checked is the one that is sent.
* A kill needs the same key twice within a second. A killed vehicle gets no orders until it is
  reset.
"""

from __future__ import annotations

import contextlib
import re
from collections import deque
from collections.abc import Callable

from textual.app import App

from groundstation.client.client import FleetClient
from groundstation.console import theme
from groundstation.console.clients import ConsoleClient, OrderingClient
from groundstation.console.panels import Panels
from groundstation.console.screens.countdown_screen import CountdownScreen
from groundstation.console.screens.dialogs import QuitScreen
from groundstation.console.screens.live import LiveScreen
from groundstation.console.screens.preview_screen import PreviewScreen
from groundstation.console.screens.vehicle_screen import VehicleScreen
from groundstation.console.theme import CALM, FAINT, KILL, PHASE_SIGNS, SEVERITY_SIGNS
from groundstation.console.widgets.notices import notices
from groundstation.console.widgets.order_line import CONTROL_ORDERS
from groundstation.fleet.operator_control import FORCE_WORD, Control
from groundstation.fleet.stoppable import stoppable
from groundstation.missions import mission_words
from groundstation.missions.mission_orders import MissionOrders
from groundstation.orders.falling import below_words
from groundstation.orders.forecast_process import Forecaster
from groundstation.orders.grammar import OrderError, default_formation, parse
from groundstation.orders.intents import INTENTS, Intent, Kill, Takeoff, Verb
from groundstation.orders.kill_latch import KillLatch, reset
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.result import OrderResult, VehicleResult
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.plain_text import capitalised

# Orders for all vehicles that are sent on the thread that reads the terminal.
_URGENT_KEYS: dict[str, Verb] = {"ctrl+l": "land", "f9": "land", "ctrl+o": "hold", "f8": "hold"}
_ENTER = "enter"


class OrderEntry:
    """Takes the operator's orders and shows their results.

    Args:
        app: app that runs workers and shows the preview.
        fleet: the fleet file.
        client: client of the fleet, or of a record.
        panels: panels that show orders and results.
        forecaster: computes the previews; None: every order is sent at once.
        refresh: function that draws the fleet now.
    """

    def __init__(
        self,
        app: App[int],
        fleet: FleetConfig,
        client: ConsoleClient,
        panels: Panels,
        *,
        forecaster: Forecaster | None,
        refresh: Callable[[], None],
    ) -> None:
        self._app = app
        self._fleet = fleet
        self._client = client
        self._panels = panels
        self._refresh = refresh

        self._ordering = client if isinstance(client, OrderingClient) else None
        if isinstance(client, FleetClient):
            client.has_person = True
        self._forecaster = forecaster if self._ordering is not None else None
        self._is_warm = False  # whether the forecaster's process was started
        # Matches the list of all vehicles, unless the list continues before or after it.
        self._all_names: re.Pattern[str] | None = None
        if len(fleet.enabled_names) > 1:
            names = re.escape(",".join(fleet.enabled_names))
            self._all_names = re.compile(rf"(?<![\w,-]){names}(?![\w,-])")

        # Orders that the thread of the terminal has sent; shown when the loop handles their keys.
        self._sent_early: deque[OrderResult] = deque()
        # presses of kill keys, and the killed vehicles, which get no orders until they are reset
        self.latch = KillLatch()
        # the request for control that the results show, until it is answered; or empty
        self._request = ""
        self._written = ""  # the line from the order line that is being carried out, or empty
        self.missions: MissionOrders | None = None  # takes written orders about missions
        self.newest: OrderResult | None = None  # the order whose results are shown

    @property
    def can_order(self) -> bool:
        """Whether this console can give orders at all."""
        return self._ordering is not None

    @property
    def is_operator(self) -> bool:
        """Whether moves may be ordered from here.

        If not, leaving the console has no effect on the vehicles.
        """
        return self._ordering is not None and self._ordering.control.refusal("move") is None

    @property
    def armed_kill(self) -> str | None:
        """The vehicles that the next press of the kill key stops; None without a first press."""
        names = self.latch.armed(self._now_s)
        if not names:
            return None
        return self.shorten(",".join(names))

    @property
    def selected(self) -> tuple[str, ...]:
        """The vehicles to which keys apply: the marked ones, or else the one under the cursor.

        On the page of one vehicle it is always that vehicle.
        """
        table = self._panels.table
        if table.marked and not isinstance(self._app.screen, VehicleScreen):
            return table.marked
        if table.selected is not None:
            return (table.selected,)
        return ()

    @property
    def _now_s(self) -> float:
        return self._client.now_ns() * 1e-9

    def shorten(self, text: str) -> str:
        """Return ``text`` with ``all`` instead of the list of all vehicles."""
        if self._all_names is None:
            return text
        return self._all_names.sub("all", text)

    def update(self) -> None:
        """Update the notices and the control of the fleet."""
        control = None
        if self._ordering is not None:
            control = self._ordering.control
            control.update(self._client.state)
            self._show_answer(control)
        is_mission_flying = self.missions is not None and self.missions.is_flying
        shown = notices(self.latch.killed, control, is_mission_flying=is_mission_flying)
        self._panels.notices.show(shown)

    async def stop(self) -> None:
        """End the processes of the forecaster."""
        if self._forecaster is not None:
            await self._forecaster.stop()

    # -- written orders ----------------------------------------------------------------------------

    def open_line(self) -> None:
        """Begin to write an order; the line has the focus when this returns."""
        self._close_pages()
        line = self._panels.order_line
        line.screen.set_focus(line)
        self.warm_up()

    def show_usage(self, text: str) -> None:
        """Show the grammar of the order that is being written."""
        first_words = text.lower().split()[:1]
        for verb, kind in INTENTS.items():
            if first_words == [verb]:
                self._panels.results.show_sentence(kind.usage, FAINT)
        if first_words == ["mission"]:
            self._panels.results.show_sentence(mission_words.USAGE, FAINT)

        if text.strip():
            self.warm_up()

    async def take_line(self, text: str) -> None:
        """Carry out a written line; if it is refused, it returns to the order line."""
        self._panels.order_line.action_leave()
        self._written = text

        words = text.split()
        first_word, *further_words = words
        is_about_control = first_word in ("take", "give", "keep") and words[1:2] == ["control"]
        if is_about_control and len(words) == 2:
            self._change_control(first_word)
        elif is_about_control and len(words) == 3:
            self._change_control(first_word, words[2])
        elif mission_words.are_of_mission(words) and self.missions is not None:
            refusal = self.missions.take(words)
            if refusal:
                self._refuse(text, refusal)
        elif first_word == "reset":
            self._reset(" ".join(further_words))
        else:
            await self.order(text, is_written=True)

        self._written = ""

    def begin_line(self, verb: Verb) -> None:
        """Begin to write an order for the selected vehicles; the operator adds the numbers."""
        names = self.shorten(",".join(self.selected))
        if verb == "formation":
            formation = default_formation(self._fleet) or ""
            is_for_several = len(self.selected) > 1
            names = f"{formation} {names}" if is_for_several else formation

        self._close_pages()
        self._panels.order_line.write(f"{verb} {names} ")
        self._panels.table.keep_marks()

    def _close_pages(self) -> None:
        """Close pages in front of the order line, which would take its letters as their keys."""
        while isinstance(self._app.screen, LiveScreen):
            self._app.pop_screen()

    def warm_up(self) -> None:
        """Start the forecast's process before it is required."""
        if self._forecaster is not None and not self._is_warm:
            # Only once: a second start would cancel the first, and leave its process behind.
            self._is_warm = True
            # If it fails, the first preview tries again, and says why it fails.
            self._app.run_worker(self._forecaster.start(), group="warm", exit_on_error=False)

    # -- orders ------------------------------------------------------------------------------------

    async def order(self, order: Intent | str, *, is_written: bool = False) -> None:
        """Preview an order that could go wrong; send an order that makes a flight safer at once."""
        if isinstance(order, str):
            try:
                intent = parse(order, self._fleet)
            except OrderError as error:
                self._refuse(order, str(error))
                return
        else:
            intent = order

        if intent.is_previewed:
            await self._order_with_preview(intent)
            return

        is_written_kill = intent.verb == "kill" and is_written
        if is_written_kill and not self._is_kill_confirmed(_ENTER, intent.names):
            self._panels.order_line.take_back(str(intent))
            return
        await self.send(intent)

    async def _order_with_preview(self, intent: Intent) -> None:
        latched = self.latch.refusal(intent.names)
        if latched:
            self._refuse(str(intent), latched)
            return

        if self._forecaster is None or self._ordering is None:
            await self.send(intent)
            return

        refusal = self._ordering.control.refusal(intent.verb)
        if refusal is not None:
            self._refuse(str(intent), refusal)
            return

        screen = PreviewScreen(
            fleet=self._fleet,
            client=self._ordering,
            intent=intent,
            forecaster=self._forecaster,
            shorten=self.shorten,
            table=self._panels.table,
        )
        self._app.push_screen(screen, self._send_checked)

    def _send_checked(self, planned: PlannedOrder | None) -> None:
        if planned is None or self._ordering is None:
            return
        if self._take_off_in_waves(planned.intent):
            return
        try:
            self._show_sent(self._ordering.send(planned))
        except OrderError as error:
            self._refuse(str(planned.intent), str(error))

    def _take_off_in_waves(self, intent: Intent) -> bool:
        """Fly a take-off in waves as a mission; return whether the order is a take-off in waves."""
        if not isinstance(intent, Takeoff) or len(intent.waves) < 2 or self.missions is None:
            return False

        refusal = self.missions.take_off_in_waves(intent)
        if refusal:
            self._refuse(str(intent), refusal)
        return True

    async def send(self, order: Intent | str) -> None:
        """Send an order at once and show each vehicle's result; a wrong order shows a sentence."""
        if isinstance(order, Intent) and self._take_off_in_waves(order):
            return
        try:
            sent = await self._client.submit(order)
            self._show_sent(sent)
        except (OrderError, RuntimeError) as error:
            # RuntimeError: the bus is not open yet, or no longer open.
            self._refuse(str(order), str(error))

    def _show_sent(self, sent: OrderResult) -> None:
        """Show an order that was sent, and its results as they arrive."""
        self.newest = sent
        events = self._panels.events
        words = self.shorten(str(sent.intent))

        # The vehicles of a kill that was sent are latched, whatever its results are.
        killed = sent.planned.orders if sent.intent.verb == "kill" else ()
        if killed:
            events.add(f"KILL {','.join(killed)}", ("✖", KILL))
            self.latch.add(killed)
            self.update()

        events.add(words, ("→", CALM))
        self._panels.results.show_order(sent, words)
        sent.add_listener(lambda result: self._show_result(sent, result))
        for result in sent.results.values():
            if result.phase == "refused":
                self._log_result(result)

    def _refuse(self, order: str, reason: str) -> None:
        if self._written:
            self._panels.order_line.take_back(self._written)
        self._panels.results.show_sentence(reason)
        self._warn(f"Not sent: {theme.clean(self.shorten(order), 60)}. {reason}")

    def _warn(self, sentence: str) -> None:
        self._panels.events.add(sentence, SEVERITY_SIGNS["warning"])

    def _show_result(self, sent: OrderResult, result: VehicleResult) -> None:
        if sent is self.newest and self._app.is_running:
            self._panels.results.show_order(sent, self.shorten(str(sent.intent)))

        # For other phases the vehicle itself publishes an event. "direct" is an order that went to
        # the PX4 of a silent agent.
        if result.phase in ("refused", "no answer", "direct"):
            self._log_result(result)

    def _log_result(self, result: VehicleResult) -> None:
        sentence = result.reason or result.phase
        self._panels.events.add(sentence, PHASE_SIGNS[result.phase], vehicle=result.vehicle)

    # -- keys --------------------------------------------------------------------------------------

    def send_urgent(self, key: str) -> None:
        """Send the order of an emergency key, on the thread that reads the terminal.

        Later the event loop handles the key, and shows the order that was sent here.
        """
        verb = _URGENT_KEYS.get(key)
        if verb is None or self._ordering is None or not self._fleet.enabled_names:
            return

        # If this fails, the event loop sends the order again and shows the error.
        with contextlib.suppress(OrderError, RuntimeError):
            sent = self._ordering.submit_now(self._order_for_all(verb))
            self._sent_early.append(sent)

    async def order_all(self, verb: Verb, *, is_by_key: bool = False) -> None:
        """Land or hold all vehicles from every screen, without a question.

        Args:
            verb: the order.
            is_by_key: whether an emergency key orders it, whose order may have been sent already.
        """
        early = self._sent_early
        if is_by_key and early and early[0].planned.intent.verb == verb:
            self._show_sent(early.popleft())
        elif self._fleet.enabled_names:
            await self.send(self._order_for_all(verb))
        else:
            reason = "This fleet has nobody to order: no vehicle is enabled in its file."
            self._refuse(f"{verb} all", reason)

        # The screen changes only after the order was sent.
        self._close_questions()
        if self.missions is not None:
            self.missions.stop_countdown()

    def _order_for_all(self, verb: Verb) -> Intent:
        """Return an order for all vehicles."""
        return INTENTS[verb](vehicles=self._fleet.enabled_names, is_everybody=True)

    async def order_paths(self, verb: Verb) -> None:
        """Give an order to all vehicles that follow a path or another vehicle.

        The order to bring home also goes to all other vehicles that fly.

        Args:
            verb: pause, resume, skip or bring_home.
        """
        state = self._client.state
        names = stoppable(state, self._fleet.enabled_names)
        if verb == "bring_home":
            names = tuple(
                name
                for name in self._fleet.enabled_names
                if name in names or state.vehicles[name].is_airborne
            )

        if not names:
            self._panels.results.show_sentence("Nobody follows a path or another vehicle now.")
            return
        await self.order(INTENTS[verb](vehicles=names))

    async def order_selected(self, verb: Verb) -> None:
        """Give an order to the selected vehicles."""
        names = self.selected
        if not names:
            sentence = "No vehicle is selected: move the cursor to one, or mark some with space."
            self._panels.results.show_sentence(sentence)
            return

        if verb in ("land", "hold"):
            self._close_questions()
        await self.order(INTENTS[verb](vehicles=names))

    async def kill(self, key: str) -> None:
        """Kill the vehicle under the cursor at the second press of the same key within a second."""
        name = self._panels.table.selected
        if name is not None and self._is_kill_confirmed(key, (name,)):
            await self.send(Kill(vehicles=(name,)))

    def _is_kill_confirmed(self, key: str, names: tuple[str, ...]) -> bool:
        """Note a press of a kill key; return whether it is the second one."""
        if self.latch.press(key, names, self._now_s):
            self._close_questions()
            return True

        # names the vehicles below, on which the killed ones would fall; may be empty
        sentence = below_words(names, self._fleet, self._client.state, self._client.now_ns())
        if key == _ENTER:
            sentence = f"Enter again within 1 s stops the motors: they fall. {sentence}".rstrip()
        if sentence:
            self._panels.results.show_sentence(sentence, KILL)
        self._refresh()
        return False

    def _close_questions(self) -> None:
        """Close all open questions, because an order that makes the flight safer has come."""
        for screen in reversed(self._app.screen_stack):
            if isinstance(screen, PreviewScreen | CountdownScreen | QuitScreen):
                screen.action_drop()

    def _reset(self, names: str) -> None:
        """Carry out a reset, see :func:`groundstation.orders.kill_latch.reset`."""
        if self._ordering is None:
            self._panels.results.show_sentence("There is nobody to reset here.", FAINT)
            return
        try:
            sentence = reset(names, self.latch, self._fleet, self._ordering.forget_silent)
        except ConfigError as error:
            self._refuse(f"reset {names}", str(error))
            return
        self._panels.results.show_sentence(sentence, FAINT)
        self.update()

    # -- control of the fleet ----------------------------------------------------------------------

    def answer_request(self, answer: str) -> None:
        """Hand control over to the ground that requests it (``give``), or ``keep`` it.

        Without a request, control is not given up: a key is pressed by mistake too easily, and the
        mission that flies would end.
        """
        if answer == "give" and self._ordering is not None:
            control = self._ordering.control
            if control.is_operator and control.requester is None:
                sentence = "Nobody asks for control. To give it up, write: give control"
                self._panels.results.show_sentence(sentence, CALM)
                return
        self._change_control(answer)

    def _change_control(self, verb: str, word: str = "") -> None:
        if self._ordering is None:
            self._panels.results.show_sentence("There is nobody to control here.")
            return

        is_known = word in ("", FORCE_WORD)
        if not is_known or (word and verb != "take"):
            self._refuse(f"{verb} control {word}", f"Write one of: {', '.join(CONTROL_ORDERS)}.")
            return

        control = self._ordering.control
        self._request = ""
        if verb == "take":
            sentence = control.take(word)
            if control.is_waiting:
                self._request = sentence
        elif verb == "give":
            sentence = control.hand_over()
        else:
            sentence = control.keep()
        self._panels.results.show_sentence(sentence, CALM)
        self._panels.events.add(sentence)
        self.update()

    def _show_answer(self, control: Control) -> None:
        """Show who operates in place of a request for control that has been answered."""
        if not self._request or control.is_waiting:
            return

        results = self._panels.results
        if results.sentence == self._request:
            results.show_sentence(capitalised(f"{control.text}."), CALM)
        self._request = ""
