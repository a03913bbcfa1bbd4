"""Control authority of this ground: it takes control of a free fleet, requests it, hands it over
and gives way.

Grounds do not see each other: each learns the control tokens of the others from the vehicles'
telemetry. The rules are those of onboard/bus/control_token.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from groundstation.fleet.state import FleetState
from onboard.bus.control_token import (
    EMERGENCY,
    ControlClaim,
    ControlToken,
    next_term,
    parse_control_token,
)

SETTLE_S = 0.5  # until every vehicle has sent the operator's name
SILENCE_S = 10.0  # without an answer, after which control may be taken by force
FORCE_WORD = "force"


class TokenBus(Protocol):
    """The part of :class:`onboard.bus.protocol.Bus` for control tokens."""

    @property
    def node(self) -> str: ...
    def claim(self, token: str) -> None: ...
    def release(self, token: str) -> None: ...


class Control:
    """Control authority of one ground.

    Args:
        bus: tokens are claimed there; open before :meth:`update` is called.
        author: person or program that operates from here.
        takes_control: take control at the start when nobody has it; otherwise only watch.
        say: called with (severity, sentence) on every change.
        clock_ns: the ground's monotonic clock [ns].
    """

    def __init__(
        self,
        bus: TokenBus,
        author: str,
        *,
        takes_control: bool,
        say: Callable[[str, str], None],
        clock_ns: Callable[[], int],
    ) -> None:
        self._bus, self._author, self._say, self._clock_ns = bus, author, say, clock_ns
        self._takes_control = takes_control
        self._own: dict[ControlClaim, ControlToken] = {}
        # begin of the present wait: for the first telemetry, an own claim, an answer
        self._since_ns = 0
        self._announced: ControlToken | None = None  # the last holder that was told by say
        self.holder: ControlToken | None = None  # the operator, by the vehicles' telemetry
        self.requester: ControlToken | None = None  # another ground that requests control

    @property
    def is_operator(self) -> bool:
        """Whether this ground has control, by the vehicles' telemetry."""
        return "operator" in self._own and (
            self.holder is None or self.holder == self._own["operator"]
        )

    @property
    def is_waiting(self) -> bool:
        """Whether this ground has requested control and has no answer yet."""
        return "asks" in self._own

    @property
    def text(self) -> str:
        """The operator, in a few words."""
        if self.is_operator:
            return "you operate"
        if self.is_waiting and self.holder is not None:
            return f"asking {self.holder.author} for control"
        return f"{self.holder.label} operates" if self.holder is not None else "nobody operates"

    def refusal(self, kind: str) -> str | None:
        """Check whether this ground may order.

        Args:
            kind: of the order; emergencies always may.

        Returns:
            The reason why not; None when it may.
        """
        if kind in EMERGENCY or self.is_operator or (self._takes_control and self.holder is None):
            return None
        if self.holder is None:
            return "This ground only watches, and nobody operates. To order, write: take control."
        return (
            f"{self.holder.label} operates this fleet; here only land, hold and kill are open. "
            "Ask for control with: take control."
        )

    def update(self, state: FleetState) -> None:
        """Take over the tokens in the vehicles' telemetry, and react to them.

        Args:
            state: the fleet as known now.
        """
        now_ns = self._clock_ns()
        reports = [
            view.telemetry
            for view in state.vehicles.values()
            if view.telemetry is not None and view.is_fresh(now_ns)
        ]
        if not reports:
            return
        if self._since_ns == 0:
            self._since_ns = now_ns
        # nearly always all vehicles report the same: each name is parsed once
        holders = [
            token
            for name in {one.operator for one in reports}
            if (token := parse_control_token(name)) is not None
        ]
        names = {name for roles in {one.roles for one in reports} for name in roles}
        others = {token for name in names if (token := parse_control_token(name)) is not None}
        own = self._own.get("operator")
        rivals = [token for token in holders if token != own]
        self.holder = (
            own if own is not None and own in holders else min(rivals, key=_rank, default=None)
        )
        is_settled = (now_ns - self._since_ns) * 1e-9 >= SETTLE_S
        if (
            own is not None
            and rivals
            and (any(r.beats(own) for r in rivals) if own in holders else is_settled)
        ):
            self._drop("operator")
            self.holder = min(rivals, key=_rank)
        if rivals and "operator" not in self._own:
            # once another ground operates, only an operator's command takes control
            self._takes_control = False
        self.requester = next(
            (
                one
                for one in sorted(others, key=str)
                if one.claim == "asks" and one.node != self._bus.node
            ),
            None,
        )
        self._announce()
        self._answer(others, has_holder=bool(holders), is_settled=is_settled)

    def take(self, word: str = "") -> str:
        """Take control if it is free, else request it.

        Args:
            word: FORCE_WORD takes it without consent, once the holder has left a request unanswered
                for SILENCE_S.

        Returns:
            A sentence about the outcome.
        """
        holder = self.holder
        if self.is_operator:
            return "You have control."
        if holder is None:
            self._claim(1)
            return "You take control."
        if word != FORCE_WORD:
            if not self.is_waiting:
                self._hold(ControlToken("asks", holder.term, self._bus.node, self._author))
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
        self._claim(next_term(holder.term))
        self._say(
            "warning",
            f"Control was taken from {holder.author}, who did not answer for {waited_s:.0f} s.",
        )
        return f"You take control from {holder.author}."

    def hand_over(self) -> str:
        """Hand control over to the ground that requests it; without a request, give it up.

        Returns:
            A sentence about the outcome.
        """
        if not self.is_operator:
            return "You do not have control."
        self._drop("operator")
        self._takes_control = False
        self.holder = None
        return (
            f"Control goes to {self.requester.label}."
            if self.requester is not None
            else "You gave up control."
        )

    def keep(self) -> str:
        """Refuse the request for control.

        Returns:
            A sentence about the outcome.
        """
        if self.requester is None or not self.is_operator:
            return "Nobody asks for control."
        self._hold(ControlToken("keeps", self.requester.term, self.requester.node, self._author))
        return f"You keep control; {self.requester.author} is told."

    def _answer(self, others: set[ControlToken], *, has_holder: bool, is_settled: bool) -> None:
        """React to the others' tokens: claim free control, take note of a refusal, forget an
        answered request.
        """
        kept = any(one.claim == "keeps" and one.node == self._bus.node for one in others)
        if self.is_waiting and kept:
            self._drop("asks")
            self._say(
                "warning", f"{self.holder.author if self.holder else 'The operator'} keeps control."
            )
        elif not has_holder and "operator" not in self._own:
            first = min((one for one in others if one.claim == "asks"), key=str, default=None)
            if self.is_waiting and first == self._own["asks"]:
                self._drop("asks")
                self._claim(1)
            elif self._takes_control and is_settled and first is None:
                self._claim(1)
        answer = self._own.get("keeps")
        if answer is not None and (self.requester is None or self.requester.node != answer.node):
            self._drop("keeps")

    def _announce(self) -> None:
        holder = self.holder
        if holder == self._announced:
            return
        before, self._announced = self._announced, holder
        if holder is None and before is not None:
            self._say("warning", f"{before.label} does not operate any more: nobody does.")
        elif holder is not None and holder == self._own.get("operator"):
            self._say("info", "You operate this fleet.")
        elif holder is not None:
            self._say(
                "warning" if before is not None else "info", f"{holder.label} operates this fleet."
            )

    def _claim(self, term: int) -> None:
        self._takes_control = True
        self._hold(ControlToken("operator", term, self._bus.node, self._author))
        self._since_ns = self._clock_ns()

    def _hold(self, token: ControlToken) -> None:
        self._drop(token.claim)
        parsed = parse_control_token(str(token))
        assert parsed is not None
        self._own[token.claim] = parsed
        self._bus.claim(str(parsed))

    def _drop(self, claim: ControlClaim) -> None:
        token = self._own.pop(claim, None)
        if token is not None:
            self._bus.release(str(token))


def _rank(token: ControlToken) -> tuple[int, str]:
    return (-token.term, token.node)
