"""Orders that pages give: each of them is a card that stays on the server.

A card begins as a line of the orders' grammar. What could go wrong is flown ahead first, as in the
console, and waits for its confirmation; what makes things safer is sent at once. Cards outlive the
page that has made them: a page that is loaded again shows what is under way. All pages see all
cards.

Missions, countdowns and take-offs in waves are written as in the console, one at a time; their card
ends with their verdict. They are flown by this server, and end with it.

LAND ALL and HOLD ALL have a way of their own, without a card before them.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from groundstation.client.client import FleetClient
from groundstation.fleet.operator_control import FORCE_WORD
from groundstation.missions.mission_orders import CountdownQuestion, MissionCall, MissionOrders
from groundstation.missions.mission_words import are_of_mission
from groundstation.orders.falling import below_words
from groundstation.orders.forecast_process import Forecaster
from groundstation.orders.grammar import OrderError, parse
from groundstation.orders.intents import INTENTS, Intent, Land, Takeoff
from groundstation.orders.kill_latch import KillLatch
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.prepared_order import PreparedOrder
from groundstation.orders.preview import OrderPreview
from groundstation.orders.result import OrderResult
from groundstation.verdict.verdict import Verdict
from groundstation.web.live_messages import PageMessage
from onboard.config.fleet import ConfigError
from onboard.plain_text import plain_line

MAX_CARDS = 60
CHECK_S = 0.5  # between two looks whether a card that waits still holds
MAX_WAITING_S = 120.0  # after which a card that nobody confirms is dropped
_URGENT = ("land", "hold")
_PAGE = "page"  # of the kill latch: pages are one key
_MOST_TEXT = 300


class OrderCard:
    """One order of a page."""

    def __init__(self, number: int, text: str) -> None:
        self.number = number
        self.text = text
        self.phase = "previewed"  # previewed, sent, refused or dropped
        self.sentences: tuple[str, ...] = ()  # why it was refused or dropped
        self.prepared: PreparedOrder | None = None  # while it waits for its confirmation
        self.result: OrderResult | None = None  # once it is sent
        self.computing: asyncio.Task[None] | None = None
        self.begun_s = 0.0

        # of the card of a mission only
        self.question: Callable[[], CountdownQuestion] | None = None  # before a countdown
        self.begin: Callable[[], None] | None = None  # the countdown
        self.outcome = ""  # passed or failed, once the mission has ended

    def message(self) -> PageMessage:
        """Return what a page shows of it."""
        message: PageMessage = {
            "kind": "card",
            "number": self.number,
            "text": plain_line(self.text),
            "phase": self.phase,
            "sentences": list(self.sentences),
            "outcome": self.outcome,
        }
        if self.phase == "previewed" and self.question is not None:
            asked = self.question()
            message.update(
                can_send=not asked.reasons,
                reasons=[plain_line(reason)[:_MOST_TEXT] for reason in asked.reasons],
                figures=[plain_line(line)[:_MOST_TEXT] for line in asked.lines],
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
                    "sentence": plain_line(result.sentence)[:_MOST_TEXT],
                }
                for result in self.result.results.values()
            ]
            message["is_final"] = self.result.is_final
        return message


class OrderCards:
    """All cards of one server.

    Args:
        client: of the fleet.
        forecaster: computes the previews.
        tell: takes every message that pages have to hear.
    """

    def __init__(
        self, client: FleetClient, forecaster: Forecaster, tell: Callable[[PageMessage], None]
    ) -> None:
        self._client = client
        self._forecaster = forecaster
        self._tell = tell
        self._cards: deque[OrderCard] = deque(maxlen=MAX_CARDS)
        self._latch = KillLatch()
        self._count = 0
        self.missions = MissionOrders(client, self._begin_mission, ask=self._ask_mission)
        self._mission_card: OrderCard | None = None  # whose mission is begun or asked about
        self._flying: asyncio.Task[None] | None = None

    def messages(self) -> list[PageMessage]:
        """Return all cards, the oldest first, for a page that has just been opened."""
        return [card.message() for card in self._cards]

    async def take(self, text: str) -> None:
        """Take a line of a page: an order, or a word about control or a kill's reset."""
        words = text.split()
        if not words:
            return
        if words[:2] in (["take", "control"], ["give", "control"], ["keep", "control"]):
            self._new_card(text, "sent", self._change_control(words))
            return
        if are_of_mission(words):
            self._take_mission(text, words)
            return
        if words[0] == "reset":
            self._reset(text, " ".join(words[1:]))
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
        """Land or hold everybody at once, whatever waits for its confirmation."""
        names = self._client.fleet.enabled_names
        if verb not in _URGENT or not names:
            return
        for card in self._cards:
            if card.phase == "previewed":
                self._drop(card, f"{verb.upper()} ALL came first.")
        self.missions.stop_countdown()

        intent: Intent
        if verb == "land":
            intent = Land(vehicles=names, is_everybody=True)
        else:
            intent = INTENTS["hold"](vehicles=names)
        self._send(self._new_card(f"{verb} all", "sent"), self._client.plan(intent))

    def confirm(self, number: int) -> None:
        """Send the order of a card as it is shown, if it still holds."""
        card = self._waiting(number)
        if card is not None and card.question is not None and card.begin is not None:
            if not card.question().reasons:
                self._mission_card = card
                card.phase = "sent"
                card.begin()
            self._tell(card.message())
            return
        if card is None or card.prepared is None:
            return

        checked = card.prepared.check()
        if checked is None or not card.prepared.is_sendable:
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
        """Look whether the cards that wait still hold; call it twice a second."""
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
        """End all computing; a mission that flies ends, and lands all."""
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
        card = self._new_card(text, "sent")
        if words[0] == "mission":
            self._mission_card = card
        self._answer_mission(card, self.missions.take(words))

    def _answer_mission(self, card: OrderCard, refusal: str) -> None:
        if refusal:
            card.phase = "refused"
            card.sentences = (plain_line(refusal)[:_MOST_TEXT],)
        self._tell(card.message())

    def _ask_mission(
        self, question: Callable[[], CountdownQuestion], begin: Callable[[], None]
    ) -> None:
        """Have the card of a mission wait for its confirmation, as before a countdown."""
        card = self._mission_card
        assert card is not None
        card.phase = "previewed"
        card.question = question
        card.begin = begin

    def _begin_mission(self, mission: MissionCall, line: Callable[[], str]) -> bool:
        """Fly a mission; return whether it was begun: one flies at a time."""
        if self.missions.is_flying or self._mission_card is None:
            return False
        flight = self._fly_mission(self._mission_card, mission)
        self._flying = asyncio.get_running_loop().create_task(flight)
        return True

    async def _fly_mission(self, card: OrderCard, mission: MissionCall) -> None:
        """Fly a mission, and write its verdict on its card."""
        verdict = await mission()
        card.outcome = "failed"
        if isinstance(verdict, Verdict):
            card.outcome = "passed" if verdict.passed else "failed"
            others = [sentence for sentence in verdict.sentences if sentence != verdict.summary]
            told = [verdict.summary, *others]
            card.sentences = tuple(plain_line(sentence)[:_MOST_TEXT] for sentence in told)
        self._tell(card.message())

    # -- the ways of a card ------------------------------------------------------------------------

    def _new_card(self, text: str, phase: str, *sentences: str) -> OrderCard:
        self._count += 1
        card = OrderCard(self._count, text)
        card.phase = phase
        card.sentences = tuple(sentence for sentence in sentences if sentence)
        card.begun_s = self._client.now_ns() * 1e-9
        if len(self._cards) == MAX_CARDS:
            self._forget(self._cards[0])
        self._cards.append(card)
        self._tell(card.message())
        return card

    def _preview(self, text: str, intent: Intent) -> None:
        killed = sorted(self._latch.killed.intersection(intent.names))
        if killed:
            names = ",".join(killed)
            self._new_card(text, "refused", f"{names} was killed. Look at it, then write: reset")
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
        """Begin to compute the paths of a card, in the place of those before."""
        if card.computing is not None:
            card.computing.cancel()
        assert card.prepared is not None
        card.computing = asyncio.get_running_loop().create_task(card.prepared.compute(preview))

    def _kill(self, text: str, intent: Intent) -> None:
        """Take a kill, which has to come twice within a second."""
        now_s = self._client.now_ns() * 1e-9
        if not self._latch.press(_PAGE, intent.names, now_s):
            sentence = below_words(
                intent.names, self._client.fleet, self._client.state, self._client.now_ns()
            )
            again = "Again within 1 s stops the motors: they fall."
            self._new_card(text, "refused", f"{again} {sentence}".strip())
            return
        self._latch.add(intent.names)
        self._send(self._new_card(text, "sent"), self._client.plan(intent))

    def _reset(self, text: str, names: str) -> None:
        """Let killed vehicles be ordered again: those that are named, or all."""
        vehicles = self._latch.killed
        if names:
            try:
                vehicles = frozenset(self._client.fleet.select(names))
            except ConfigError as error:
                self._new_card(text, "refused", str(error))
                return

        freed = ", ".join(sorted(self._latch.reset(vehicles)))
        sentence = "No vehicle was killed from here."
        if freed:
            sentence = f"{freed} may be ordered again."
        self._new_card(text, "sent", sentence)

    def _send(self, card: OrderCard, planned: PlannedOrder) -> None:
        try:
            self._follow(card, self._client.send(planned))
        except (OrderError, RuntimeError) as error:
            # RuntimeError: the bus is not open yet, or not any more.
            card.phase = "refused"
            card.sentences = (str(error),)
            self._tell(card.message())

    def _follow(self, card: OrderCard, result: OrderResult) -> None:
        card.result = result
        result.add_listener(lambda _: self._tell(card.message()))
        self._tell(card.message())

    def _drop(self, card: OrderCard, sentence: str) -> None:
        card.phase = "dropped"
        card.sentences = (sentence,)
        self._forget(card)
        self._tell(card.message())

    def _forget(self, card: OrderCard) -> None:
        if card.computing is not None:
            card.computing.cancel()
            card.computing = None

    def _waiting(self, number: int) -> OrderCard | None:
        for card in self._cards:
            if card.number == number and card.phase == "previewed":
                return card
        return None

    def _change_control(self, words: list[str]) -> str:
        """Take, give or keep control; return what came of it."""
        control = self._client.control
        word = words[2] if len(words) > 2 else ""
        if words[0] == "take" and word in ("", FORCE_WORD):
            return control.take(word)
        if words[0] == "give" and not word:
            return control.hand_over()
        if words[0] == "keep" and not word:
            return control.keep()
        return f"Write: take control, take control {FORCE_WORD}, give control, keep control."


def _paths(prepared: PreparedOrder) -> dict[str, list[tuple[float, float, float]]]:
    """Return the computed paths by vehicle; none before they are computed."""
    if prepared.forecast is None:
        return {}
    return {name: list(path) for name, path in prepared.forecast.paths_enu_m.items()}
