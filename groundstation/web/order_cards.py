"""Orders that pages give: each of them is a card that stays on the server.

A card begins as a line of the orders' grammar. What could go wrong is flown ahead first, as in the
console, and waits for its confirmation; what makes things safer is sent at once. Cards outlive the
page that has made them: a page that is loaded again shows what is under way. All pages see all
cards.

LAND ALL and HOLD ALL have a way of their own, without a card before them.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Any

from groundstation.client.client import FleetClient, waves_refusal
from groundstation.fleet.operator_control import FORCE_WORD
from groundstation.orders.falling import below_words
from groundstation.orders.forecast_process import Forecaster
from groundstation.orders.grammar import OrderError, parse
from groundstation.orders.intents import INTENTS, Intent, Land
from groundstation.orders.kill_latch import KillLatch
from groundstation.orders.plan import PlannedOrder
from groundstation.orders.prepared_order import PreparedOrder
from groundstation.orders.preview import OrderPreview
from groundstation.orders.result import OrderResult
from onboard.config.fleet import ConfigError
from onboard.plain_text import plain_line

MAX_CARDS = 60
CHECK_S = 0.5  # between two looks whether a card that waits still holds
MAX_WAITING_S = 120.0  # after which a card that nobody confirms is dropped
_URGENT = ("land", "hold")
_PAGE = "page"  # of the kill latch: pages are one key
_MOST_TEXT = 300

PageMessage = dict[str, Any]


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

    def message(self) -> PageMessage:
        """Return what a page shows of it."""
        message: PageMessage = {
            "kind": "card",
            "number": self.number,
            "text": plain_line(self.text),
            "phase": self.phase,
            "sentences": list(self.sentences),
        }
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

        intent: Intent
        if verb == "land":
            intent = Land(vehicles=names, is_everybody=True)
        else:
            intent = INTENTS["hold"](vehicles=names)
        self._send(self._new_card(f"{verb} all", "sent"), self._client.plan(intent))

    def confirm(self, number: int) -> None:
        """Send the order of a card as it is shown, if it still holds."""
        card = self._waiting(number)
        if card is None or card.prepared is None:
            return

        checked = card.prepared.check()
        if checked is None or not card.prepared.is_sendable:
            self._tell(card.message())
            return
        card.phase = "sent"
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
            if card.phase != "previewed" or card.prepared is None:
                continue
            if now_s - card.begun_s > MAX_WAITING_S:
                self._drop(card, "Nobody confirmed it.")
            else:
                card.prepared.check()

    async def stop(self) -> None:
        """End all computing."""
        for card in self._cards:
            if card.computing is not None:
                card.computing.cancel()
        await self._forecaster.stop()

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
        refusal = self._client.control.refusal(intent.verb) or waves_refusal(intent)
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
