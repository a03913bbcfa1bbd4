"""This ground's part in the question who operates: takes control when it is free, asks, hands over, gives way.

What is known comes from the vehicles' telemetry, since grounds do not see each other. Rules: onboard/bus/authority.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from groundstation.fleet.state import FleetState
from onboard.bus.authority import EMERGENCY, MAX_TERM, Role, Token, parse_token

SETTLE_S = 0.5  # until every vehicle that is there has told who operates
SILENCE_S = 10.0  # after which control may be taken by force
FORCE_WORD = "force"


class TokenBus(Protocol):
    """What is needed of the bus."""

    @property
    def node(self) -> str: ...
    def claim(self, token: str) -> None: ...
    def release(self, token: str) -> None: ...


class Control:
    """Whether this ground operates.

    Args:
        bus: where tokens are claimed; open before :meth:`look` is called.
        wants: take control at the start when nobody has it; otherwise only watch.
        say: hears what changed, as (severity, sentence).
        clock_ns: the ground's clock.
    """

    def __init__(
        self,
        bus: TokenBus,
        author: str,
        *,
        wants: bool,
        say: Callable[[str, str], None],
        clock_ns: Callable[[], int],
    ) -> None:
        self._bus, self._author, self._say, self._clock_ns = bus, author, say, clock_ns
        self._wants = wants
        self._own: dict[Role, Token] = {}
        self._since_ns = 0  # of what is waited for: the first telemetry, an own claim, an answer
        self._seen: Token | None = None
        self.holder: Token | None = None
        self.asker: Token | None = None

    @property
    def is_operator(self) -> bool:
        """Whether this ground has control, as far as any vehicle says."""
        return "operator" in self._own and (self.holder is None or self.holder == self._own["operator"])

    @property
    def is_waiting(self) -> bool:
        """Whether this ground has asked for control and has no answer yet."""
        return "asks" in self._own

    @property
    def text(self) -> str:
        """Who operates, in a few words."""
        if self.is_operator:
            return "you operate"
        if self.is_waiting and self.holder is not None:
            return f"asking {self.holder.author} for control"
        return f"{self.holder.label} operates" if self.holder is not None else "nobody operates"

    def refusal(self, kind: str) -> str | None:
        """Why an order of this kind may not be given from here; None when it may. Emergencies always may."""
        if kind in EMERGENCY or self.is_operator or (self._wants and self.holder is None):
            return None
        if self.holder is None:
            return "This ground only watches, and nobody operates. To order, write: take control."
        return (
            f"{self.holder.label} operates this fleet; here only land, hold and kill are open. "
            "Ask for control with: take control."
        )

    def look(self, state: FleetState) -> None:
        """Take over what the vehicles say, and do what follows from it."""
        now_ns = self._clock_ns()
        told = [
            view.telemetry for view in state.vehicles.values() if view.telemetry is not None and view.is_fresh(now_ns)
        ]
        if not told:
            return
        if self._since_ns == 0:
            self._since_ns = now_ns
        # all vehicles say the same nearly always: each name is read once
        holders = [token for name in {one.operator for one in told} if (token := parse_token(name)) is not None]
        names = {name for roles in {one.roles for one in told} for name in roles}
        others = {token for name in names if (token := parse_token(name)) is not None}
        own = self._own.get("operator")
        rivals = [token for token in holders if token != own]
        self.holder = own if own is not None and own in holders else min(rivals, key=_rank, default=None)
        is_settled = (now_ns - self._since_ns) * 1e-9 >= SETTLE_S
        if own is not None and rivals and (any(r.beats(own) for r in rivals) if own in holders else is_settled):
            self._drop("operator")
            self.holder = min(rivals, key=_rank)
        if rivals and "operator" not in self._own:
            self._wants = False  # who has watched somebody operate takes control only when told to
        self.asker = next(
            (one for one in sorted(others, key=str) if one.role == "asks" and one.node != self._bus.node), None
        )
        self._tell()
        self._answer(others, has_holder=bool(holders), is_settled=is_settled)

    def take(self, word: str = "") -> str:
        """Take control if it is free, else ask for it; what happens now, in a sentence.

        Args:
            word: FORCE_WORD takes it without consent, once the holder has been asked and silent for a while.
        """
        holder = self.holder
        if self.is_operator:
            return "You have control."
        if holder is None:
            self._claim(1)
            return "You take control."
        if word != FORCE_WORD:
            if not self.is_waiting:
                self._hold(Token("asks", holder.term, self._bus.node, self._author))
                self._since_ns = self._clock_ns()
            return f"Asking {holder.label} for control."
        waited_s = (self._clock_ns() - self._since_ns) * 1e-9
        if not self.is_waiting:
            return f"Ask {holder.author} first, with: take control."
        if waited_s < SILENCE_S:
            return (
                f"{holder.author} was asked {waited_s:.0f} s ago. Wait until {SILENCE_S:.0f} s have passed without an "
                "answer."
            )
        self._drop("asks")
        self._claim(min(holder.term + 1, MAX_TERM))
        self._say("warning", f"Control was taken from {holder.author}, who did not answer for {waited_s:.0f} s.")
        return f"You take control from {holder.author}."

    def give(self) -> str:
        """Hand control over to who asks; with nobody asking, give it up."""
        if not self.is_operator:
            return "You do not have control."
        self._drop("operator")
        self._wants = False
        self.holder = None
        return f"Control goes to {self.asker.label}." if self.asker is not None else "You gave up control."

    def keep(self) -> str:
        """Answer no to who asks."""
        if self.asker is None or not self.is_operator:
            return "Nobody asks for control."
        self._hold(Token("keeps", self.asker.term, self.asker.node, self._author))
        return f"You keep control; {self.asker.author} is told."

    def _answer(self, others: set[Token], *, has_holder: bool, is_settled: bool) -> None:
        """What follows by itself: claim what is free, hear a no, forget an answered question."""
        kept = any(one.role == "keeps" and one.node == self._bus.node for one in others)
        if self.is_waiting and kept:
            self._drop("asks")
            self._say("warning", f"{self.holder.author if self.holder else 'The operator'} keeps control.")
        elif not has_holder and "operator" not in self._own:
            first = min((one for one in others if one.role == "asks"), key=str, default=None)
            if self.is_waiting and first == self._own["asks"]:
                self._drop("asks")
                self._claim(1)
            elif self._wants and is_settled and first is None:
                self._claim(1)
        answer = self._own.get("keeps")
        if answer is not None and (self.asker is None or self.asker.node != answer.node):
            self._drop("keeps")

    def _tell(self) -> None:
        holder = self.holder
        if holder == self._seen:
            return
        before, self._seen = self._seen, holder
        if holder is None and before is not None:
            self._say("warning", f"{before.label} does not operate any more: nobody does.")
        elif holder is not None and holder == self._own.get("operator"):
            self._say("info", "You operate this fleet.")
        elif holder is not None:
            self._say("warning" if before is not None else "info", f"{holder.label} operates this fleet.")

    def _claim(self, term: int) -> None:
        self._wants = True
        self._hold(Token("operator", term, self._bus.node, self._author))
        self._since_ns = self._clock_ns()

    def _hold(self, token: Token) -> None:
        self._drop(token.role)
        parsed = parse_token(str(token))
        assert parsed is not None
        self._own[token.role] = parsed
        self._bus.claim(str(parsed))

    def _drop(self, role: Role) -> None:
        token = self._own.pop(role, None)
        if token is not None:
            self._bus.release(str(token))


def _rank(token: Token) -> tuple[int, str]:
    return (-token.term, token.node)
