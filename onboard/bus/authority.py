"""Who may give orders: roles as liveliness tokens, and the rules that agents and grounds share. Pure.

A ground that operates holds ``operator.TERM.NODE.AUTHOR``, one that wants to ``asks...``, an operator who answers no
``keeps...`` with the asking node. A token vanishes with its process, so nobody operates from the grave. Grounds do not
see each other, only agents; so every agent tells in its telemetry which tokens it sees.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, get_args

from onboard.bus.schema import Order, OrderKind

Role = Literal["operator", "asks", "keeps"]
ROLES: tuple[Role, ...] = get_args(Role)
EMERGENCY: tuple[OrderKind, ...] = ("land", "hold", "kill")
MAX_TERM = 10**6
_MAX_TOKENS = 64


@dataclass(frozen=True, slots=True)
class Token:
    """One role of one ground; ``term`` grows when control is taken by force. For "keeps" ``node`` is who asked."""

    role: Role
    term: int
    node: str
    author: str

    def __str__(self) -> str:
        return f"{self.role}.{self.term}.{_word(self.node)}.{_word(self.author)}"

    @property
    def who(self) -> str:
        """Its author and node: two grounds of one user are told apart by the latter."""
        return f"{self.author} ({self.node})"

    def beats(self, other: Token) -> bool:
        """Whether this one operates where two claimed at once: the later term, then the lower name."""
        return (-self.term, self.node) < (-other.term, other.node)


def parse_token(name: str) -> Token | None:
    """The token of this name; None for any other node."""
    role, *rest = name.split(".")
    known = next((known for known in ROLES if known == role), None)
    if known is None or len(rest) != 3 or not re.fullmatch(r"\d{1,7}", rest[0]) or not rest[1]:
        return None
    return Token(known, min(int(rest[0]), MAX_TERM), rest[1], rest[2])


class Roles:
    """The role tokens that one agent sees, and who operates by them.

    Who operates goes on operating while its token lives, whoever claims later, unless somebody claims a later term.
    """

    def __init__(self) -> None:
        self.holder: Token | None = None
        self._tokens: dict[str, Token] = {}

    def see(self, name: str, is_alive: bool) -> None:
        """A token of the bus came or went; other nodes' tokens change nothing."""
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
        """The holder's token for telemetry; empty when nobody operates."""
        return "" if self.holder is None else str(self.holder)

    @property
    def others(self) -> tuple[str, ...]:
        """All other role tokens, for telemetry."""
        return tuple(sorted(name for name, token in self._tokens.items() if token != self.holder))

    def refusal(self, order: Order) -> str | None:
        """Why this order is not for its sender to give; None when it is. Who makes things safer need not operate."""
        holder = self.holder
        if holder is None or order.kind in EMERGENCY or order.node == holder.node:
            return None
        return (
            f"{holder.author} operates this fleet (from {holder.node}): land, hold and kill are everybody's, other "
            "orders the operator's. Ask for control in the console: take control."
        )


def _word(text: str) -> str:
    """Text as one part of a token's name; what a key expression may not hold becomes an underscore."""
    return re.sub(r"[^\w-]", "_", text)[:60] or "_"
