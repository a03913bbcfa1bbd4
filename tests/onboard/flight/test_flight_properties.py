"""Properties of all sequences of orders, failsafes and observations, on the state machine alone."""

from __future__ import annotations

from collections import Counter
from typing import get_args

from hypothesis import given, settings
from hypothesis import strategies as st

from onboard import agent_commands
from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import BESIDE, Event, Order, OrderKind, PathOrder
from onboard.control.path import path_of
from onboard.flight import state_machine
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep, FlightView
from onboard.safety.failsafe_table import TABLE, Action, Condition
from tests.onboard.agent.rig import fleet

KINDS = sorted(set(get_args(OrderKind)) - set(BESIDE))
orders = st.sampled_from(KINDS)
conditions = st.sampled_from(list(Condition))
observations = st.tuples(
    st.booleans(),  # armed
    st.sampled_from(["OFFBOARD", "HOLD", "LAND"]),
    st.sampled_from([Landed.ON_GROUND, Landed.IN_AIR]),
    st.floats(0.0, 2.0),  # height [m]
    st.integers(1, 200),  # ticks until the next happening
)


class Machine:
    """A flight that takes whatever comes, and what it has sent."""

    def __init__(self, step: FlightStep = FlightStep.WAITING) -> None:
        config = fleet()
        self.flight = FlightContext(config, config.vehicles["mav0"], step=step)
        self.flight.path.path = path_of([[1.0, *[0.0] * 32]])
        self.view = FlightView(
            now_ns=10**9,
            position_enu_m=(0.0, 0.0, 0.0),
            velocity_enu_m_s=(0.0, 0.0, 0.0),
            has_position=True,
            snapshot=Snapshot(landed=Landed.ON_GROUND),
        )
        self.begun: list[str] = []
        self.ends: Counter[str] = Counter()

    def order(self, kind: OrderKind) -> None:
        """Begin an order if the table has a row for it."""
        if state_machine.accepts(self.flight.step, kind):
            identity = f"o{len(self.begun)}"
            self.begun.append(identity)
            order = Order(
                order_id=identity,
                author="x",
                kind=kind,
                stamp_ns=0,
                deadline_ns=0,
                position_enu_m=(1.0, 0.0, 1.0),
                path=PathOrder(path_id="p", show_id="s", start_ns=self.view.now_ns),
            )
            state_machine.begin_order(self.flight, self.view, order)
            self.check()

    def fail(self, condition: Condition) -> None:
        """Take the action of the failsafe table."""
        action = TABLE[self.flight.situation, condition]
        state_machine.begin_failsafe(self.flight, self.view, action, f"{condition.value}.")
        self.check()
        if action is Action.STOP:
            assert not self.flight.step.is_streaming

    def observe(self, armed: bool, mode: str, landed: Landed, height_m: float, count: int) -> None:
        """Let time pass."""
        for _ in range(count):
            now_ns = self.view.now_ns + 20_000_000
            snapshot = Snapshot(heartbeat_ns=now_ns, is_armed=armed, mode=mode, landed=landed)
            self.view = FlightView(
                now_ns=now_ns,
                position_enu_m=(0.0, 0.0, height_m),
                velocity_enu_m_s=(0.0, 0.0, 0.0),
                has_position=True,
                snapshot=snapshot,
            )
            state_machine.advance(self.flight, self.view)
            self.check()

    def check(self) -> None:
        """Every order that has begun ends once, and only a flight that streams asks for OFFBOARD or
        to arm.
        """
        for command in self.flight.take_commands():
            if isinstance(command, (agent_commands.Arm, agent_commands.SetOffboard)):
                assert self.flight.step.is_streaming, self.flight.step
            if (
                isinstance(command, agent_commands.Publish)
                and isinstance(command.message, Event)
                and command.message.order_outcome
            ):
                self.ends[command.message.order_id] += 1
        running = [] if self.flight.order is None else [self.flight.order.order_id]
        assert self.ends == Counter(identity for identity in self.begun if identity not in running)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(orders, conditions, observations), max_size=25))
def test_every_order_that_begins_ends_exactly_once_whatever_happens(
    story: list[OrderKind | Condition | tuple[bool, str, Landed, float, int]],
) -> None:
    machine = Machine()
    for happening in story:
        if isinstance(happening, Condition):
            machine.fail(happening)
        elif isinstance(happening, tuple):
            machine.observe(*happening)
        else:
            machine.order(happening)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(conditions, observations), max_size=15), st.sampled_from([*FlightStep]))
def test_after_a_kill_nothing_streams_until_an_order_says_so(
    story: list[Condition | tuple[bool, str, Landed, float, int]], step: FlightStep
) -> None:
    machine = Machine(step)
    machine.order("kill")
    for happening in story:
        if isinstance(happening, Condition):
            machine.fail(happening)
        else:
            machine.observe(*happening)
        assert not machine.flight.step.is_streaming
