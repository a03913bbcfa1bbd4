"""Control of a fleet by this ground: claim it if it is free, request it, hand it over, give it up.

Grounds are not connected to each other. Each learns the control tokens of the others from the
vehicles' telemetry. The rules are in onboard/bus/control_token.py.

A ground claims up to three kinds of tokens: `operator` for the control that it has, `asks` for a
request, and `keeps` to refuse another ground's request.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

from groundstation.fleet.state import FleetState
from onboard.bus.control_token import (
    OPEN_TO_ALL,
    ControlClaim,
    ControlToken,
    next_term,
    parse_control_token,
)
from onboard.bus.schema import Telemetry

SETTLE_S = 0.5  # time in which every vehicle reports the operator
SILENCE_S = 10.0  # time without an answer after which control may be taken by force
FORCE_WORD = "force"
_FIRST_TERM = 1  # number of the first operator's token; each takeover by force counts on
# verbs that the operator may order from all grounds of the same person, see
# onboard/bus/control_token.py
_OPEN_TO_SAME_PERSON = ("resume", "skip", "home", "bring_home")


class TokenBus(Protocol):
    """The part of :class:`onboard.bus.protocol.Bus` that handles control tokens."""

    @property
    def node(self) -> str:
        """Return the name of this node."""
        ...

    def claim(self, token: str) -> None:
        """Show a token of control to all nodes."""
        ...

    def release(self, token: str) -> None:
        """Take a token of control back."""
        ...


class Control:
    """Control of one ground.

    Args:
        bus: bus on which tokens are claimed; it must be open before :meth:`update` is called.
        author: person or program that operates from here.
        takes_control: whether to take control at the start if no ground has it, or only to watch.
        say: function for severity and sentence of every change.
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
        self._bus = bus
        self._author = author
        self._takes_control = takes_control
        self._say = say
        self._clock_ns = clock_ns
        self._own_tokens: dict[ControlClaim, ControlToken] = {}  # tokens of this ground by claim
        # Time of the first telemetry, or of this ground's last claim or request. From then on it
        # waits SETTLE_S for reports, and SILENCE_S for an answer. 0: no telemetry has come yet.
        self._wait_begin_ns = 0
        self._announced: ControlToken | None = None  # the last holder that was announced
        self.holder: ControlToken | None = None  # the operator, by the vehicles' telemetry
        self.requester: ControlToken | None = None  # another ground that requests control

    @property
    def is_operator(self) -> bool:
        """Whether this ground has control, by the vehicles' telemetry."""
        if "operator" not in self._own_tokens:
            return False
        return self.holder is None or self.holder == self._own_tokens["operator"]

    @property
    def is_waiting(self) -> bool:
        """Whether this ground has requested control and has no answer yet."""
        return "asks" in self._own_tokens

    @property
    def text(self) -> str:
        """The operator, in a few words."""
        if self.is_operator:
            return "you operate"
        if self.holder is None:
            return "nobody operates"
        if self.is_waiting:
            return f"asking {self.holder.author} for control"
        return f"{self.holder.label} operates"

    def refusal(self, kind: str) -> str | None:
        """Return why this ground may not give an order; None if it may.

        Args:
            kind: verb of the order; every ground may give orders that make a flight safer.
        """
        if kind in OPEN_TO_ALL or self.is_operator:
            return None
        if (
            kind in _OPEN_TO_SAME_PERSON
            and self.holder is not None
            and self.holder.is_of(self._author)
        ):
            return None

        if self.holder is None:
            if self._takes_control:
                return None
            return "This ground only watches, and nobody operates. To order, write: take control."
        return (
            f"{self.holder.label} operates this fleet; here only land, hold, pause and kill are "
            "open. Ask for control in covey tui or on a page of covey web: take control."
        )

    def update(self, state: FleetState) -> None:
        """Read the tokens in the vehicles' telemetry, and react to them.

        Args:
            state: the fleet as known now.
        """
        now_ns = self._clock_ns()
        reports = []
        for view in state.vehicles.values():
            if view.telemetry is not None and view.is_fresh(now_ns):
                reports.append(view.telemetry)
        if not reports:
            return
        if self._wait_begin_ns == 0:
            self._wait_begin_ns = now_ns
        is_settled = (now_ns - self._wait_begin_ns) * 1e-9 >= SETTLE_S

        holders, tokens = _tokens_of(reports)
        self._give_way(holders, is_settled=is_settled)

        requests = [
            token for token in tokens if token.claim == "asks" and token.node != self._bus.node
        ]
        self.requester = min(requests, key=_text_of, default=None)

        self._announce()
        self._answer(tokens, has_holder=bool(holders), is_settled=is_settled)

    def take(self, word: str = "") -> str:
        """Take control if it is free; otherwise request it.

        Args:
            word: FORCE_WORD to take it without consent, after the holder has not answered a request
                for SILENCE_S.

        Returns:
            A sentence about the outcome.
        """
        holder = self.holder
        if self.is_operator:
            return "You have control."
        if holder is None:
            self._claim(_FIRST_TERM)
            return "You take control."

        if word != FORCE_WORD:
            if not self.is_waiting:
                self._hold(self._token("asks", holder.term, self._bus.node))
                self._wait_begin_ns = self._clock_ns()
            return f"Asking {holder.label} for control."

        if not self.is_waiting:
            return f"Ask {holder.author} first, with: take control."
        waited_s = (self._clock_ns() - self._wait_begin_ns) * 1e-9
        if waited_s < SILENCE_S:
            return (
                f"{holder.author} was asked {waited_s:.0f} s ago. "
                f"Wait until {SILENCE_S:.0f} s have passed without an answer."
            )
        self._claim(next_term(holder.term))
        self._say(
            "warning",
            f"Control was taken from {holder.author}, who did not answer for {waited_s:.0f} s.",
        )
        return f"You take control from {holder.author}."

    def hand_over(self) -> str:
        """Hand control over to the ground that requests it; if none does, give it up.

        Returns:
            A sentence about the outcome.
        """
        if not self.is_operator:
            return "You do not have control."

        self._drop("operator")
        self._takes_control = False
        self.holder = None
        if self.requester is None:
            return "You gave up control."
        return f"Control goes to {self.requester.label}."

    def keep(self) -> str:
        """Refuse the request for control.

        Returns:
            A sentence about the outcome.
        """
        if self.requester is None or not self.is_operator:
            return "Nobody asks for control."

        self._hold(self._token("keeps", self.requester.term, self.requester.node))
        return f"You keep control; {self.requester.author} is told."

    # -- what the vehicles report ------------------------------------------------------------------

    def _give_way(self, holders: Sequence[ControlToken], *, is_settled: bool) -> None:
        """Note who operates, and give up this ground's claim if another ground's claim wins.

        While vehicles report two holders, the token with the higher rank wins. This ground gives up
        a claim that no vehicle reports, once all vehicles have had time to report it.
        """
        own_claim = self._own_tokens.get("operator")
        rivals = [token for token in holders if token != own_claim]

        if own_claim is not None and own_claim in holders:
            self.holder = own_claim
            has_lost = any(rival.beats(own_claim) for rival in rivals)
        else:
            self.holder = min(rivals, key=_rank, default=None)
            has_lost = own_claim is not None and bool(rivals) and is_settled
        if has_lost:
            self._drop("operator")
            self.holder = min(rivals, key=_rank)

        if rivals and "operator" not in self._own_tokens:
            # After another ground has operated, only a command of the user takes control.
            self._takes_control = False

    def _answer(self, tokens: set[ControlToken], *, has_holder: bool, is_settled: bool) -> None:
        """React to the tokens of all grounds.

        Claim free control, note a refusal of this ground's request, and withdraw this ground's
        refusal when the other ground's request has gone.
        """
        # a token `keeps` names the node whose request its sender refuses
        is_refused = any(
            token.claim == "keeps" and token.node == self._bus.node for token in tokens
        )
        if self.is_waiting and is_refused:
            self._drop("asks")
            author = "The operator" if self.holder is None else self.holder.author
            self._say("warning", f"{author} keeps control.")
        elif not has_holder and "operator" not in self._own_tokens:
            self._claim_free_control(tokens, is_settled=is_settled)

        refusal = self._own_tokens.get("keeps")
        requesting_node = None if self.requester is None else self.requester.node
        if refusal is not None and requesting_node != refusal.node:
            self._drop("keeps")

    def _claim_free_control(self, tokens: set[ControlToken], *, is_settled: bool) -> None:
        """Claim control that no ground has.

        If there are requests, the ground of the first one claims it. If there are none, a ground
        that takes control at its start claims it.
        """
        requests = [token for token in tokens if token.claim == "asks"]
        first_request = min(requests, key=_text_of, default=None)

        is_first = self.is_waiting and first_request == self._own_tokens["asks"]
        takes_unasked = self._takes_control and is_settled and first_request is None
        if is_first or takes_unasked:
            self._claim(_FIRST_TERM)

    def _announce(self) -> None:
        """Say who operates, if that has changed."""
        holder = self.holder
        last_holder = self._announced
        if holder == last_holder:
            return

        self._announced = holder
        if holder is None:
            if last_holder is not None:
                self._say("warning", f"{last_holder.label} does not operate any more: nobody does.")
        elif holder == self._own_tokens.get("operator"):
            self._say("info", "You operate this fleet.")
        else:
            severity = "info" if last_holder is None else "warning"
            self._say(severity, f"{holder.label} operates this fleet.")

    # -- own tokens --------------------------------------------------------------------------------

    def _claim(self, term: int) -> None:
        """Claim control, and ask for it no more; telemetry shows whether it is granted."""
        self._drop("asks")
        self._takes_control = True
        self._hold(self._token("operator", term, self._bus.node))
        self._wait_begin_ns = self._clock_ns()

    def _token(self, claim: ControlClaim, term: int, node: str) -> ControlToken:
        return ControlToken(claim, term, node, self._author)

    def _hold(self, token: ControlToken) -> None:
        """Claim a token on the bus; it replaces this ground's earlier token of the same kind."""
        self._drop(token.claim)
        # The text of a token shortens names. Parsed from its text, the token equals the one that
        # telemetry will report.
        parsed = parse_control_token(str(token))
        assert parsed is not None
        self._own_tokens[token.claim] = parsed
        self._bus.claim(str(parsed))

    def _drop(self, claim: ControlClaim) -> None:
        """Release this ground's token of a kind, if there is one."""
        token = self._own_tokens.pop(claim, None)
        if token is not None:
            self._bus.release(str(token))


def _tokens_of(reports: Sequence[Telemetry]) -> tuple[list[ControlToken], set[ControlToken]]:
    """Return the holders of control that vehicles report, and all tokens that they see.

    Nearly always all vehicles report the same names, so each name is parsed only once.
    """
    holder_names = {report.operator for report in reports}
    token_lists = {report.roles for report in reports}
    token_names = {name for names in token_lists for name in names}
    return _parsed(holder_names), set(_parsed(token_names))


def _parsed(names: Iterable[str]) -> list[ControlToken]:
    """Return the tokens with these names; names of other nodes are left out."""
    tokens = []
    for name in names:
        token = parse_control_token(name)
        if token is not None:
            tokens.append(token)
    return tokens


def _rank(token: ControlToken) -> tuple[int, str]:
    """Return the sort key by which the later term comes first, then the lower node."""
    return (-token.term, token.node)


def _text_of(token: ControlToken) -> str:
    """Return the sort key of requests; all grounds see the same texts, so all choose the same."""
    return str(token)
