"""Keeps the orders that pages give, each as a card that stays on the server.

A card begins as a line of the orders' grammar. As in the console, an order that could go wrong is
previewed first and waits for its confirmation; an order that makes things safer is sent at once.
Cards outlive the page that made them: a page that is loaded again shows the orders under way. All
pages see all cards.

Missions, countdowns and take-offs in waves are written as in the console, one at a time; their card
ends with their verdict. They are flown by this server, and end with it.

LAND ALL and HOLD ALL do not come as lines: :meth:`OrderCards.urgent` sends them at once.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence

from groundstation.client.client import FleetClient
from groundstation.fleet.operator_control import FORCE_WORD
from groundstation.missions.mission_orders import CountdownQuestion, MissionCall, MissionOrders
from groundstation.missions.mission_words import are_of_mission
from groundstation.orders.falling import below_words
from groundstation.orders.forecast_process import Forecaster
from groundstation.orders.grammar import OrderError, parse
from groundstation.orders.intents import INTENTS, Intent, Takeoff
from groundstation.orders.kill_latch import KillLatch, reset
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.prepared_order import PreparedOrder
from groundstation.orders.preview import OrderPreview
from groundstation.orders.result import OrderResult
from groundstation.verdict.verdict import Verdict
from groundstation.web.live_messages import PageMessage
from onboard.config.fleet import ConfigError
from onboard.plain_text import plain_line

MAX_CARDS = 60
MAX_LINE = 12_000  # number of letters of a line at most: the names of 255 vehicles fit in
CHECK_S = 0.5  # period of the checks of waiting cards
MAX_WAITING_S = 120.0  # time after which a card without confirmation is dropped
_URGENT = ("land", "hold")
_PAGE = "page"  # the kill latch's key for all pages together
_MAX_TEXT = 300  # number of letters of a text at most


class OrderCard:
    """One order of a page."""

    def __init__(self, number: int, text: str) -> None:
        self.number = number
        self.text = text
        # previewed (the card waits for its confirmation), sent, answered (nothing is under way),
        # refused or dropped
        self.phase = "previewed"
        self.sentences: tuple[str, ...] = ()  # the reasons of a refusal or drop, or an answer
        self.prepared: PreparedOrder | None = None  # set for an order that needs a confirmation
        self.result: OrderResult | None = None  # set once the order is sent
        self.computing: asyncio.Task[None] | None = None
        self.begun_s = 0.0  # time on the ground's clock at which it was made

        # These are set for missions only.
        self.question: Callable[[], CountdownQuestion] | None = None  # asked before a countdown
        self.begin: Callable[[], None] | None = None  # begins the countdown
        self.outcome = ""  # passed or failed, once the mission has ended

    def message(self) -> PageMessage:
        """Return the card as a message to pages."""
        message: PageMessage = {
            "kind": "card",
            "number": self.number,
            "text": plain_line(self.text),
            "phase": self.phase,
            "sentences": list(self.sentences),
            "outcome": self.outcome,
        }
        if self.phase == "previewed" and self.question is not None:
            question = self.question()
            message.update(
                can_send=not question.reasons,
                reasons=[plain_line(reason)[:_MAX_TEXT] for reason in question.reasons],
                figures=[plain_line(line)[:_MAX_TEXT] for line in question.lines],
            )
        prepared = self.prepared
        if self.phase == "previewed" and prepared is not None and prepared.preview is not None:
            message.update(
                is_computing=prepared.is_computing,
                can_send=prepared.is_sendable,
                reasons=list(prepared.reasons),
                figures=[*prepared.figures(), *prepared.preview.notes, prepared.note],
                goals_enu_m=prepared.preview.goals,
                paths_enu_m=_paths(prepared),
            )
        if self.result is not None:
            message["results"] = [
                {
                    "vehicle": result.vehicle,
                    "phase": result.phase,
                    "sentence": plain_line(result.reason)[:_MAX_TEXT],
                }
                for result in self.result.results.values()
            ]
            message["is_final"] = self.result.is_final
        return message


class OrderCards:
    """All cards of one server.

    Args:
        client: the client of the fleet.
        forecaster: the process that computes the previews.
        tell: sends a message to all pages.
    """

    def __init__(
        self, client: FleetClient, forecaster: Forecaster, tell: Callable[[PageMessage], None]
    ) -> None:
        self._client = client
        self._forecaster = forecaster
        self._tell = tell
        self._cards: deque[OrderCard] = deque(maxlen=MAX_CARDS)
        self.latch = KillLatch()  # the vehicles that pages have killed
        self._count = 0
        self.missions = MissionOrders(
            client, self._begin_mission, ask=self._ask_mission, latch=self.latch
        )
        self._mission_card: OrderCard | None = None  # card of the latest mission
        self._flying: asyncio.Task[None] | None = None

    def messages(self) -> list[PageMessage]:
        """Return all cards, the oldest first, for a page that has just been opened."""
        return [card.message() for card in self._cards]

    async def take(self, text: str) -> None:
        """Take a line of a page: an order, a mission, a change of control or a kill's reset."""
        words = text.split()
        if not words:
            return
        if len(text) > MAX_LINE:
            reason = (
                f"The line has {len(text)} letters, more than {MAX_LINE}, so nothing was sent. "
                "Order fewer vehicles at once."
            )
            self._new_card(text[:_MAX_TEXT], "refused", reason)
            return
        first_word, *further_words = words
        if words[:2] in (["take", "control"], ["give", "control"], ["keep", "control"]):
            self._change_control(text, words)
            return
        if are_of_mission(words):
            self._take_mission(text, words)
            return
        if first_word == "reset":
            self._reset(text, " ".join(further_words))
            return

        try:
            intent = parse(text, self._client.fleet)
        except OrderError as error:
            self._new_card(text, "refused", str(error))
            return

        if intent.is_previewed:
            self._preview(text, intent)
        elif intent.verb == "kill":
            self._kill(text, intent)
        else:
            self._send(self._new_card(text, "sent"), self._client.plan(intent))

    def urgent(self, verb: str) -> None:
        """Land or hold all vehicles at once; all waiting cards are dropped."""
        names = self._client.fleet.enabled_names
        if verb not in _URGENT or not names:
            return
        for card in self._cards:
            if card.phase == "previewed":
                self._drop(card, f"{verb.upper()} ALL came first.")
        self.missions.stop_countdown()

        intent = INTENTS[verb](vehicles=names, is_everybody=True)
        self._send(self._new_card(f"{verb} all", "sent"), self._client.plan(intent))

    def confirm(self, number: int) -> None:
        """Send the order of a card as it is shown, if it is still allowed."""
        card = self._waiting(number)
        if card is None:
            return
        if card.question is not None and card.begin is not None:
            self._confirm_countdown(card, card.question(), card.begin)
        elif card.prepared is not None:
            self._confirm_order(card, card.prepared)

    def _confirm_countdown(
        self, card: OrderCard, question: CountdownQuestion, begin: Callable[[], None]
    ) -> None:
        """Begin the countdown of a mission's card, unless there is a reason against it now."""
        if not question.reasons:
            self._mission_card = card
            card.phase = "sent"
            begin()
        self._tell(card.message())

    def _confirm_order(self, card: OrderCard, prepared: PreparedOrder) -> None:
        """Send the order of a card, unless a check refuses it now."""
        checked = prepared.check()
        if checked is None or not prepared.is_sendable:
            self._tell(card.message())
            return
        card.phase = "sent"
        if isinstance(checked.intent, Takeoff) and len(checked.intent.waves) > 1:
            self._mission_card = card
            self._answer_mission(card, self.missions.take_off_in_waves(checked.intent))
        else:
            self._send(card, checked)

    def drop(self, number: int) -> None:
        """Drop a card that waits for its confirmation."""
        card = self._waiting(number)
        if card is not None:
            self._drop(card, "Dropped.")

    def check_waiting(self) -> None:
        """Check the waiting cards again, and drop old ones; call it every CHECK_S."""
        now_s = self._client.now_ns() * 1e-9
        for card in self._cards:
            if card.phase != "previewed":
                continue
            if now_s - card.begun_s > MAX_WAITING_S:
                self._drop(card, "Nobody confirmed it.")
            elif card.prepared is not None:
                card.prepared.check()
            elif card.question is not None:
                self._tell(card.message())

    async def stop(self) -> None:
        """Stop all computations, and a flying mission, which then lands all vehicles."""
        if self._flying is not None and self.missions.is_flying:
            self.missions.take(["stop"])
            await asyncio.wait([self._flying])
        for card in self._cards:
            if card.computing is not None:
                card.computing.cancel()
        await self._forecaster.stop()

    # -- missions ----------------------------------------------------------------------------------

    def _take_mission(self, text: str, words: list[str]) -> None:
        """Take a line about a mission: a mission to fly, or a word for the one that flies."""
        if words[0] == "mission":
            card = self._new_card(text, "sent")
            self._mission_card = card
        else:
            card = self._new_card(text, "answered")
        self._answer_mission(card, self.missions.take(words))

    def _answer_mission(self, card: OrderCard, refusal: str) -> None:
        """Show the answer to a mission line; an empty refusal accepts the line."""
        if refusal:
            card.phase = "refused"
            card.sentences = (plain_line(refusal)[:_MAX_TEXT],)
        self._tell(card.message())

    def _ask_mission(
        self, question: Callable[[], CountdownQuestion], begin: Callable[[], None]
    ) -> None:
        """Let a mission's card wait for the confirmation of its countdown."""
        card = self._mission_card
        assert card is not None
        card.phase = "previewed"
        card.question = question
        card.begin = begin

    def _begin_mission(self, mission: MissionCall, line: Callable[[], str]) -> bool:
        """Begin to fly a mission; return False if another one is flying."""
        if self.missions.is_flying or self._mission_card is None:
            return False
        flight = self._fly_mission(self._mission_card, mission)
        self._flying = asyncio.get_running_loop().create_task(flight)
        return True

    async def _fly_mission(self, card: OrderCard, mission: MissionCall) -> None:
        """Fly a mission, and write its verdict on its card."""
        try:
            verdict = await mission()
        except Exception as error:  # noqa: BLE001 - it is shown; the operator still gives orders
            card.outcome = "failed"
            reason = plain_line(f"The mission broke off: {type(error).__name__}: {error}")
            card.sentences = (reason[:_MAX_TEXT], "Land with LAND ALL.")
            self._tell(card.message())
            return
        card.outcome = "failed"
        if isinstance(verdict, Verdict):
            if verdict.passed:
                card.outcome = "passed"
            others = [sentence for sentence in verdict.sentences if sentence != verdict.summary]
            sentences = [verdict.summary, *others]
            card.sentences = tuple(plain_line(sentence)[:_MAX_TEXT] for sentence in sentences)
        self._tell(card.message())

    # -- steps of a card ---------------------------------------------------------------------------

    def _new_card(self, text: str, phase: str, *sentences: str) -> OrderCard:
        """Add a card and show it; with MAX_CARDS the oldest one is removed."""
        self._count += 1
        card = OrderCard(self._count, text)
        card.phase = phase
        card.sentences = tuple(sentence for sentence in sentences if sentence)
        card.begun_s = self._client.now_ns() * 1e-9
        if len(self._cards) == MAX_CARDS:
            oldest = self._cards[0]
            self._stop_computing(oldest)
        self._cards.append(card)
        self._tell(card.message())
        return card

    def _preview(self, text: str, intent: Intent) -> None:
        """Make a card that shows an order's preview and waits for its confirmation."""
        latched = self.latch.refusal(intent.names)
        if latched:
            self._new_card(text, "refused", latched)
            return
        refusal = self._client.control.refusal(intent.verb)
        if refusal is not None:
            self._new_card(text, "refused", refusal)
            return

        card = self._new_card(text, "previewed")
        card.prepared = PreparedOrder(
            self._client.fleet,
            self._client,
            intent,
            self._forecaster,
            start=lambda preview: self._compute(card, preview),
            on_change=lambda: self._tell(card.message()),
        )
        card.prepared.begin()

    def _compute(self, card: OrderCard, preview: OrderPreview) -> None:
        """Begin to compute the paths of a card; an earlier computation is cancelled."""
        if card.computing is not None:
            card.computing.cancel()
        assert card.prepared is not None
        card.computing = asyncio.get_running_loop().create_task(card.prepared.compute(preview))

    def _kill(self, text: str, intent: Intent) -> None:
        """Take a kill order, which must be given twice within a second."""
        now_s = self._client.now_ns() * 1e-9
        if not self.latch.press(_PAGE, intent.names, now_s):
            sentence = below_words(
                intent.names, self._client.fleet, self._client.state, self._client.now_ns()
            )
            request = "Again within 1 s stops the motors: they fall."
            self._new_card(text, "refused", f"{request} {sentence}".strip())
            return
        card = self._new_card(text, "sent")
        self._send(card, self._client.plan(intent))
        if card.result is not None:
            killed = tuple(card.result.planned.orders)
            self.latch.add(killed)
            self._drop_orders_to(killed)

    def _drop_orders_to(self, killed: Sequence[str]) -> None:
        """Drop waiting cards whose order is to a killed vehicle."""
        for card in self._cards:
            if card.phase != "previewed" or card.prepared is None:
                continue
            names = [name for name in card.prepared.intent.names if name in killed]
            if names:
                self._drop(card, f"{', '.join(names)} was killed.")

    def _reset(self, text: str, names: str) -> None:
        """Carry out a reset, see :func:`groundstation.orders.kill_latch.reset`."""
        client = self._client
        try:
            sentence = reset(names, self.latch, client.fleet, client.forget_silent)
        except ConfigError as error:
            self._new_card(text, "refused", str(error))
            return
        self._new_card(text, "answered", sentence)

    def _send(self, card: OrderCard, planned: PlannedOrder) -> None:
        try:
            self._follow(card, self._client.send(planned))
        except (OrderError, RuntimeError) as error:
            # RuntimeError: the bus is not open yet, or no longer open.
            card.phase = "refused"
            card.sentences = (str(error),)
            self._tell(card.message())

    def _follow(self, card: OrderCard, result: OrderResult) -> None:
        """Show each change of an order's result on its card."""
        card.result = result
        result.add_listener(lambda _: self._tell(card.message()))
        self._tell(card.message())

    def _drop(self, card: OrderCard, sentence: str) -> None:
        card.phase = "dropped"
        card.sentences = (sentence,)
        self._stop_computing(card)
        self._tell(card.message())

    def _stop_computing(self, card: OrderCard) -> None:
        if card.computing is not None:
            card.computing.cancel()
            card.computing = None

    def _waiting(self, number: int) -> OrderCard | None:
        """Return the card with a number if it waits for its confirmation."""
        for card in self._cards:
            if card.number == number and card.phase == "previewed":
                return card
        return None

    def _change_control(self, text: str, words: list[str]) -> None:
        """Take, give or keep control, and show the answer on a card.

        Args:
            text: the line of the page.
            words: its words; the second one is ``control``.
        """
        control = self._client.control
        verb, _, *rest = words
        further_words = " ".join(rest)

        if verb == "take" and further_words in ("", FORCE_WORD):
            answer = control.take(further_words)
        elif verb == "give" and not further_words:
            answer = control.hand_over()
        elif verb == "keep" and not further_words:
            answer = control.keep()
        else:
            usage = f"Write: take control, take control {FORCE_WORD}, give control, keep control."
            self._new_card(text, "refused", usage)
            return
        self._new_card(text, "answered", answer)


def _paths(prepared: PreparedOrder) -> dict[str, list[tuple[float, float, float]]]:
    """Return the previewed paths by vehicle; empty before they are computed."""
    if prepared.forecast is None:
        return {}
    return {name: list(path) for name, path in prepared.forecast.paths_enu_m.items()}
