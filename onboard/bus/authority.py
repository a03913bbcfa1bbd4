"""The operator of a fleet: roles as liveliness tokens, and the rules that agents and grounds share. Pure.

A ground that operates declares the token ``operator.TERM.NODE.AUTHOR``, one that requests control ``asks...``, and an
operator who refuses it ``keeps...`` with the node of the request. A token vanishes with its process, so a ground that
has ended cannot stay the operator. Grounds are connected to agents only, not to each other; therefore every agent
publishes in its telemetry the tokens that it sees.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, get_args

from onboard.bus.schema import Order, OrderKind

Role = Literal["operator", "asks", "keeps"]
ROLES: tuple[Role, ...] = get_args(Role)
EMERGENCY: tuple[OrderKind, ...] = ("land", "hold", "kill")  # orders that anybody may send
GROUND, WATCHER = "ground", "watcher"  # first words of the nodes that may order, and of those that only watch
MAX_TERM = 10**6
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

    def beats(self, other: Token) -> bool:
        """Whether this token wins where two grounds claimed to operate at once: the later term, then the lower node.

        Args:
            other: token of the other ground.
        Returns:
            True if this token wins.
        """
        return (-self.term, self.node) < (-other.term, other.node)


def parse_token(name: str) -> Token | None:
    """Parse a name on the bus as a role token.

    Args:
        name: of a liveliness token.
    Returns:
        the token; None for the name of any other node.
    """
    role, *rest = name.split(".")
    known = next((known for known in ROLES if known == role), None)
    if known is None or len(rest) != 3 or not re.fullmatch(r"\d{1,7}", rest[0]) or not rest[1]:
        return None
    return Token(known, min(int(rest[0]), MAX_TERM), rest[1], rest[2])


class Roles:
    """The role tokens that one agent sees, and the operator that follows from them.

    The operator stays the operator while its token lives, whoever claims later, unless the later claim has a later
    term.
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
        elif len(self._tokens) < _MAX_TOKENS:
            self._tokens[name] = token
        claims = [token for token in self._tokens.values() if token.role == "operator"]
        latest = max((token.term for token in claims), default=0)
        if self.holder not in claims or self.holder is None or self.holder.term < latest:
            rivals = sorted(claims, key=lambda token: (-token.term, token.node))
            self.holder = rivals[0] if rivals else None

    @property
    def operator(self) -> str:
        """The operator's token for telemetry; empty when nobody operates."""
        return "" if self.holder is None else str(self.holder)

    @property
    def others(self) -> tuple[str, ...]:
        """All other role tokens, for telemetry."""
        return tuple(sorted(name for name, token in self._tokens.items() if token != self.holder))

    def refusal(self, order: Order) -> str | None:
        """Judge whether the sender of an order may give it. Orders that make a flight safer are open to everybody.

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
    """Return a text as one part of a token's name: characters that a key may not hold become underscores."""
    return re.sub(r"[^\w-]", "_", text)[:60] or "_"
