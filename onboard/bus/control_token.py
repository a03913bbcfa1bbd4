"""Control of a fleet: the liveliness tokens that show who has control, and their rules. Pure.

Agents and grounds share these rules. A ground that operates the fleet declares the token
``operator.TERM.NODE.AUTHOR``. One that requests control declares ``asks.TERM.NODE.AUTHOR``. An
operator who refuses a request declares ``keeps.TERM.NODE.AUTHOR``, where NODE is the node that
requested control.

A token vanishes with its process, so a ground that has ended cannot remain the operator. Grounds
are connected to agents only, not to each other. Therefore every agent publishes in its telemetry
the tokens that it sees.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, get_args

from onboard.bus.schema import Order, OrderKind

ControlClaim = Literal["operator", "asks", "keeps"]
CONTROL_CLAIMS: tuple[ControlClaim, ...] = get_args(ControlClaim)

EMERGENCY: tuple[OrderKind, ...] = ("land", "hold", "kill")  # orders that end a flight or a path
OPEN_TO_ALL: tuple[OrderKind, ...] = (*EMERGENCY, "pause")  # orders that anybody may send
# Orders that every ground of the operating person may send. A script or a mission operates in its
# own process, while the person watches from another ground. The same holds for a move that flies
# home and lands.
_OF_THE_PERSON: tuple[OrderKind, ...] = ("resume", "skip")

# A vehicle refuses a mission's order that would replace a newer order of a person. Its sentence
# ends like this, and grounds recognise the refusal by this text.
ORDER_STAYS = "that order stays."

GROUND = "ground"  # first word of the nodes that may order
WATCHER = "watcher"  # first word of the nodes that only watch

LAST_TERM = 999  # the term after this one is 1
_TERM = re.compile(r"[1-9]\d{0,2}")
_MAX_TOKENS = 64
_MAX_PART_LENGTH = 60  # characters of a node's or an author's name within a token


@dataclass(frozen=True, slots=True)
class ControlToken:
    """Declaration of one ground about control of the fleet."""

    claim: ControlClaim  # it operates, requests control, or refuses a request
    term: int  # grows each time that control is taken by force
    node: str  # of the ground; for "keeps" the node that requested control
    author: str  # name of the user

    def __str__(self) -> str:
        return f"{self.claim}.{self.term}.{_token_part(self.node)}.{_token_part(self.author)}"

    @property
    def label(self) -> str:
        """Author and node; the node distinguishes two grounds of one user."""
        return f"{self.author} ({self.node})"

    def is_of(self, author: str) -> bool:
        """Whether the person with this user name has declared this token."""
        return self.author == _token_part(author)

    def follows(self, other: ControlToken) -> bool:
        """Whether this token takes control from the other by force: its term is the next one.

        Args:
            other: token of the other ground.
        Returns:
            True for the next term only. If every later term counted, a false claim with the last
            term would keep control forever.
        """
        return self.term == next_term(other.term)

    def beats(self, other: ControlToken) -> bool:
        """Whether this token wins when two grounds operate at once.

        The later term wins. With equal terms, the node whose name sorts first wins.

        Args:
            other: token of the other ground.
        Returns:
            True if this token wins.
        """
        # term 1 follows the last term, so a term counts as later if it is ahead by up to half of
        # all terms
        terms_ahead = (self.term - other.term) % LAST_TERM
        if terms_ahead == 0:
            return self.node < other.node
        return terms_ahead <= LAST_TERM // 2


def next_term(term: int) -> int:
    """Return the term of a ground that takes control by force from the holder of ``term``."""
    return term % LAST_TERM + 1


def parse_control_token(name: str) -> ControlToken | None:
    """Parse a name on the bus as a control token.

    Args:
        name: name of a liveliness token.
    Returns:
        the token; None for the name of any other node.
    """
    parts = name.split(".")
    if len(parts) != 4:
        return None

    first_word, term, node, author = parts
    for claim in CONTROL_CLAIMS:
        if claim == first_word and _TERM.fullmatch(term) and node:
            return ControlToken(claim, int(term), node, author)
    return None


class ControlTokens:
    """The control tokens that one agent sees, and the operator that follows from them.

    The operator keeps this role while its token lives, unless another ground claims control with
    the next term.
    """

    def __init__(self) -> None:
        self.holder: ControlToken | None = None  # token of the operator
        self._tokens: dict[str, ControlToken] = {}  # by their names on the bus

    def see(self, name: str, is_alive: bool) -> None:
        """Note a liveliness token that appeared or vanished. Only control tokens have an effect.

        Args:
            name: name of the token.
            is_alive: whether it appeared; False when it vanished.
        """
        token = parse_control_token(name)
        if token is None:
            return

        if is_alive:
            self._tokens[name] = token
            self._limit_number()
        else:
            self._tokens.pop(name, None)

        self._choose_holder()

    def _limit_number(self) -> None:
        """Forget the oldest token if there are too many, so that false tokens cannot block new
        ones.
        """
        if len(self._tokens) <= _MAX_TOKENS:
            return
        oldest = next(name for name, token in self._tokens.items() if token != self.holder)
        del self._tokens[oldest]

    def _choose_holder(self) -> None:
        """Choose the operator's token. The present one stays unless another takes control by
        force.
        """
        claims = [token for token in self._tokens.values() if token.claim == "operator"]
        claims.sort(key=lambda token: token.node)  # every agent decides in the same order

        # without a holder, begin with the lowest term, because each claim by force has the next
        # term
        if self.holder not in claims:
            self.holder = min(claims, key=lambda token: token.term, default=None)

        for token in claims:
            if self.holder is not None and token.follows(self.holder):
                self.holder = token

    @property
    def operator(self) -> str:
        """The operator's token for telemetry; empty when nobody operates."""
        if self.holder is None:
            return ""
        return str(self.holder)

    @property
    def others(self) -> tuple[str, ...]:
        """All other control tokens, for telemetry."""
        return tuple(sorted(name for name, token in self._tokens.items() if token != self.holder))

    def refusal(self, order: Order) -> str | None:
        """Return why the sender of an order is not allowed to give it.

        Everybody may send orders that make a flight safer. Every ground of the operating person may
        send orders that follow a pause (to resume, to skip, to go home).

        Args:
            order: the order as received.
        Returns:
            the sentence that refuses the order; None when it is allowed.
        """
        holder = self.holder
        if holder is None or order.kind in OPEN_TO_ALL or order.node == holder.node:
            return None

        is_home = order.kind == "move" and order.then_land
        is_of_the_person = order.kind in _OF_THE_PERSON or is_home
        if is_of_the_person and holder.is_of(order.author):
            return None
        return (
            f"{holder.author} operates this fleet (from {holder.node}). Everybody may order land, "
            "hold, pause and kill; all other orders are the operator's. To ask for control, type "
            "in the console: take control."
        )


def _token_part(text: str) -> str:
    """Return a text as one part of a token's name.

    Characters that are not allowed in a key of the bus become underscores. An empty text becomes an
    underscore, too.
    """
    part = re.sub(r"[^\w-]", "_", text)[:_MAX_PART_LENGTH]
    if not part:
        return "_"
    return part
