"""Sends the fleet's state, events and orders to every open page.

The state message is made once for all pages, ten times a second, and each page gets the newest one
when it is ready for it: a page on a slow computer gets fewer states, and delays no other. Events
and cards wait in a queue of the page; a page that does not receive them in time is closed.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from groundstation.alarms.alarms import LATCHED, Alarms
from groundstation.client.client import FleetClient
from groundstation.fleet.state import LoggedEvent
from groundstation.orders.forecast_process import Forecaster
from groundstation.scene.ground_tiles import GroundTiles
from groundstation.web.live_messages import (
    PageMessage,
    event_message,
    fleet_message,
    state_message,
)
from groundstation.web.order_cards import CHECK_S, OrderCards
from onboard.bus.schema import Event
from onboard.config.fleet import FleetConfig
from onboard.plain_text import plain_line

STATE_PERIOD_S = 0.1
MAX_EVENTS = 200  # most past events that a new page gets
MAX_QUEUED = 500  # most messages that wait for one page
SEND_LIMIT_S = 10.0  # longest time for sending one message

Send = Callable[[str], Any]  # returns an awaitable

log = logging.getLogger(__name__)

_encode = msgspec.json.Encoder().encode


class TooSlow(Exception):
    """A page does not receive its messages in time."""


class Page:
    """The messages that wait for one page."""

    def __init__(self) -> None:
        self._queue: deque[str] = deque()
        self._state = ""  # newest state, until it is sent
        self._has_more = asyncio.Event()
        self.is_too_slow = False

    def tell(self, text: str) -> None:
        """Queue a message."""
        if len(self._queue) >= MAX_QUEUED:
            self.is_too_slow = True
        else:
            self._queue.append(text)
        self._has_more.set()

    def tell_state(self, text: str) -> None:
        """Replace the waiting state by the newest one."""
        self._state = text
        self._has_more.set()

    async def send_all(self, send: Send) -> None:
        """Send all messages as they come, until it is cancelled.

        Args:
            send: sends one text to the page.

        Raises:
            TooSlow: the page does not receive its messages in time.
        """
        while True:
            await self._has_more.wait()
            self._has_more.clear()
            if self.is_too_slow:
                raise TooSlow

            texts = list(self._queue)
            self._queue.clear()
            if self._state:
                texts.append(self._state)
                self._state = ""

            for text in texts:
                try:
                    async with asyncio.timeout(SEND_LIMIT_S):
                        await send(text)
                except TimeoutError:
                    raise TooSlow from None


class LiveFeed:
    """Sends the fleet to all open pages, and holds the orders that they give.

    Args:
        fleet: the fleet file.
        client: the client that follows the fleet.
        can_order: whether pages may give orders.
        forecaster: the process that computes previews.
        ground: the server's pictures of the ground.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        client: FleetClient,
        *,
        can_order: bool,
        forecaster: Forecaster | None = None,
        ground: GroundTiles | None = None,
    ) -> None:
        self._fleet = fleet
        self._client = client
        self._can_order = can_order
        self._fleet_text = _text(fleet_message(fleet, can_order=can_order, ground=ground))
        self._alarms = Alarms(fleet)
        self._pages: set[Page] = set()
        self._events: deque[str] = deque(maxlen=MAX_EVENTS)
        self._tasks: list[asyncio.Task[None]] = []
        self.cards: OrderCards | None = None
        if can_order:
            self.cards = OrderCards(client, forecaster or Forecaster(), self._tell)

    @property
    def pages(self) -> int:
        """Number of open pages."""
        return len(self._pages)

    async def start(self) -> None:
        """Connect with the fleet and begin to send its state.

        Raises:
            BusError: the bus cannot be opened.
        """
        self._client.add_event_listener(self._on_event)
        if self._can_order:
            self._client.has_person = True
        await self._client.start()
        self._tasks = [asyncio.create_task(self._tell_states())]
        if self.cards is not None:
            self._tasks.append(asyncio.create_task(self._check_cards(self.cards)))

    async def stop(self) -> None:
        """Disconnect from the fleet, even if vehicles fly; a second call does nothing."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._tasks = []
        if self.cards is not None:
            await self.cards.stop()
        await self._client.stop()

    def open(self) -> Page:
        """Return a new page, whose first messages are the fleet, the last events and all cards."""
        page = Page()
        page.tell(self._fleet_text)
        for event in self._events:
            page.tell(event)
        if self.cards is not None:
            for card in self.cards.messages():
                page.tell(_text(card))
        page.tell_state(self._state_text())
        self._pages.add(page)
        return page

    def close(self, page: Page) -> None:
        """Send no more messages to a page."""
        self._pages.discard(page)

    def acknowledge(self, kind: str, subject: str) -> None:
        """Acknowledge the alarm of a single event, which ends it; all others end by themselves.

        Args:
            kind: the alarm's kind, as pages have it.
            subject: its subject, as pages have it.
        """
        for line in self._alarms.lines:
            alarm = line.alarm
            is_meant = (alarm.kind.value, plain_line(alarm.subject)) == (kind, subject)
            if is_meant and alarm.kind in LATCHED:
                self._alarms.acknowledge(line)

    # -- messages to all pages ---------------------------------------------------------------------

    async def _tell_states(self) -> None:
        while True:
            await asyncio.sleep(STATE_PERIOD_S)
            with _logged():
                self._tell_state()

    def _tell_state(self) -> None:
        if self.cards is not None:
            self._client.control.update(self._client.state)
        # Alarms have their ages also if they began while no page was open.
        self._alarms.update(self._client.state, self._client.now_ns())
        if not self._pages:
            return
        text = self._state_text()
        for page in self._pages:
            page.tell_state(text)

    async def _check_cards(self, cards: OrderCards) -> None:
        while True:
            await asyncio.sleep(CHECK_S)
            with _logged():
                cards.check_waiting()

    def _state_text(self) -> str:
        now_ns = self._client.now_ns()
        state = self._client.state
        control = None
        if self._can_order:
            control = self._client.control
        mission = ("", False)  # the mission's line in words, and whether it counts down
        latch = None
        if self.cards is not None:
            latch = self.cards.latch
            mission = (self.cards.missions.live_line, self.cards.missions.counts_down)
        return _text(
            state_message(
                state,
                self._fleet,
                alarms=self._alarms.lines,
                control=control,
                now_ns=now_ns,
                mission=mission,
                latch=latch,
            )
        )

    def _on_event(self, event: Event) -> None:
        if event.severity == "debug":
            return
        logged = LoggedEvent(received_ns=self._client.now_ns(), event=event)
        text = _text(event_message(logged))
        self._events.append(text)
        self._tell_text(text)

    def _tell(self, message: PageMessage) -> None:
        self._tell_text(_text(message))

    def _tell_text(self, text: str) -> None:
        for page in self._pages:
            page.tell(text)


@contextlib.contextmanager
def _logged() -> Iterator[None]:
    """Log an exception of one round; the next round goes on, and so does the shutdown."""
    try:
        yield
    except Exception:
        log.exception("The page could not be kept up to date")


def _text(message: PageMessage) -> str:
    return _encode(message).decode()
