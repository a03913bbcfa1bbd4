"""The operator of a fleet: roles as liveliness tokens, and the rules that agents and grounds share.
Pure.

A ground that operates declares the token ``operator.TERM.NODE.AUTHOR``, one that requests control
``asks...``, and an operator who refuses it ``keeps...`` with the node of the request. A token
vanishes with its process, so a ground that has ended cannot stay the operator. Grounds are
connected to agents only, not to each other; therefore every agent publishes in its telemetry the
tokens that it sees.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, get_args

from onboard.bus.schema import Order, OrderKind

Role = Literal["operator", "asks", "keeps"]
ROLES: tuple[Role, ...] = get_args(Role)
EMERGENCY: tuple[OrderKind, ...] = ("land", "hold", "kill")  # orders that anybody may send
# first words of the nodes that may order, and of those that only watch
GROUND, WATCHER = "ground", "watcher"
LAST_TERM = 999  # then it begins anew with 1
_MAX_TOKENS = 64


@dataclass(frozen=True, slots=True)
class Token:
    """One role of one ground."""

    role: Role
    term: int  # grows each time that control is taken by force
    node: str  # of the ground; for "keeps" the node that requested control
    author: str  # name of the user

    def __str__(self) -> str:
        return f"{self.role}.{self.term}.{_token_part(self.node)}.{_token_part(self.author)}"

    @property
    def label(self) -> str:
        """Author and node; the node distinguishes two grounds of one user."""
        return f"{self.author} ({self.node})"

    def follows(self, other: Token) -> bool:
        """Whether this is the claim of who takes control from the other by force: the next term.

        Args:
            other: token of the other ground.
        Returns:
            True for the next term, and for no other, since a false one could never be followed.
        """
        return self.term == next_term(other.term)

    def beats(self, other: Token) -> bool:
        """Whether this token wins where two grounds operate at once: the later term, then the lower
        node.

        Args:
            other: token of the other ground.
        Returns:
            True if this token wins.
        """
        ahead = (self.term - other.term) % LAST_TERM
        return self.node < other.node if ahead == 0 else ahead <= LAST_TERM // 2


def next_term(term: int) -> int:
    """Return the term of who takes control by force from the holder of ``term``."""
    return term % LAST_TERM + 1


def parse_token(name: str) -> Token | None:
    """Parse a name on the bus as a role token.

    Args:
        name: of a liveliness token.
    Returns:
        the token; None for the name of any other node.
    """
    role, *rest = name.split(".")
    known = next((known for known in ROLES if known == role), None)
    if known is None or len(rest) != 3 or not re.fullmatch(r"[1-9]\d{0,2}", rest[0]) or not rest[1]:
        return None
    return Token(known, int(rest[0]), rest[1], rest[2])


class Roles:
    """The role tokens that one agent sees, and the operator that follows from them.

    The operator stays the operator while its token lives, whoever claims later, unless that claim
    has the next term.
    """

    def __init__(self) -> None:
        self.holder: Token | None = None  # token of the operator
        self._tokens: dict[str, Token] = {}

    def see(self, name: str, is_alive: bool) -> None:
        """Take note of a liveliness token; tokens of other nodes change nothing.

        Args:
            name: of the token.
            is_alive: whether it appeared; False when it vanished.
        """
        token = parse_token(name)
        if token is None:
            return
        if not is_alive:
            self._tokens.pop(name, None)
        else:
            self._tokens[name] = token
            if len(self._tokens) > _MAX_TOKENS:  # false names must not exclude who comes after them
                self._tokens.pop(
                    next(one for one, token in self._tokens.items() if token != self.holder)
                )
        claims = sorted(
            (one for one in self._tokens.values() if one.role == "operator"),
            key=lambda one: one.node,
        )
        if self.holder not in claims:
            self.holder = min(claims, key=lambda one: one.term, default=None)
        for one in claims:
            if self.holder is not None and one.follows(self.holder):
                self.holder = one

    @property
    def operator(self) -> str:
        """The operator's token for telemetry; empty when nobody operates."""
        return "" if self.holder is None else str(self.holder)

    @property
    def others(self) -> tuple[str, ...]:
        """All other role tokens, for telemetry."""
        return tuple(sorted(name for name, token in self._tokens.items() if token != self.holder))

    def refusal(self, order: Order) -> str | None:
        """Judge whether the sender of an order may give it. Orders that make a flight safer are
        open to everybody.

        Args:
            order: as received.
        Returns:
            the sentence that refuses it; None when it is allowed.
        """
        holder = self.holder
        if holder is None or order.kind in EMERGENCY or order.node == holder.node:
            return None
        return (
            f"{holder.author} operates this fleet (from {holder.node}). Everybody may order land, hold and kill; all "
            "other orders are the operator's. To ask for control, type in the console: take control."
        )


def _token_part(text: str) -> str:
    """Return a text as one part of a token's name: characters that a key may not hold become
    underscores.
    """
    return re.sub(r"[^\w-]", "_", text)[:60] or "_"
