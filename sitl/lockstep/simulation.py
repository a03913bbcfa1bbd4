"""Agents' cores, emulated vehicles, motion capture and bus, advanced together in steps of 4 ms.

Each step has the same order: calls that were planned for this time, physics and autopilots, links,
motion capture and ground truth, the bus, and in every fifth step the agents. All agents tick at the
same instant, so a neighbour's message is one whole period old when it is used. That is the worst
case of a real fleet, whose agents tick at different instants.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from onboard.bus.codec import Malformed
from onboard.bus.pose_publisher import PosePublisher
from onboard.bus.schema import FaultOrder, OrderReply
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from sitl.bus_messages import TRUTH_EVERY_STEPS, Broadcast, answer_fault
from sitl.emulator.emulator import Environment
from sitl.emulator.mocap import MocapSettings
from sitl.faults.catalogue import Fault
from sitl.fleet_emulator import emulator_of
from sitl.fleet_faults import refuse_absent_source
from sitl.lockstep.agents import AgentShell
from sitl.lockstep.bus import SimBus
from sitl.lockstep.connections import LONGEST_BUS_DELAY_S, BusSettings
from sitl.lockstep.direct_link import LinkBank
from sitl.lockstep.pipeline_rows import CompiledPipeline
from sitl.physics.vehicle import STEP_S

if TYPE_CHECKING:
    from sitl.lockstep.base_station import BaseStation

STEP_NS = round(STEP_S * 1e9)
EPOCH_NS = 1_000_000_000  # the time at the start; it is not 0, because a time of 0 means "never"
TICK_STEPS = 5  # physics steps from one tick of the agents to the next
_SIMULATOR = "sitl"


class _BusFault(NamedTuple):
    """An active fault of the bus."""

    fault: Fault
    others: list[str]  # nodes whose connection with the faulty vehicle it has changed


class Simulation:
    """A simulated fleet without a ground station.

    Args:
        fleet: the fleet file; all its enabled vehicles fly.
        seed: the seed of all random numbers.
        bus: quality of the bus connections.
        mocap: quality of the motion capture.
        environment: wind, downwash and errors; a calm room by default.
        is_compiled: whether compiled code computes the agents' pipeline; interpreted code gives the
            same result up to rounding.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        *,
        seed: int = 0,
        bus: BusSettings | None = None,
        mocap: MocapSettings | None = None,
        environment: Environment | None = None,
        is_compiled: bool = True,
    ) -> None:
        self.fleet = fleet
        self.names = fleet.enabled_names
        vehicles = [fleet.vehicles[name] for name in self.names]

        self.emulator = emulator_of(fleet, vehicles, seed=seed, environment=environment)
        self.emulator.outside = self._change_outside
        self._vehicles = self.emulator.world.vehicles
        self._broadcast = Broadcast(
            self.emulator,
            vehicles,
            mocap,
            people=fleet.people,
            seed=seed,
            boot_id=1,
            stamp_ns=lambda time_s: EPOCH_NS + round(time_s * 1e9),
        )

        self.bus = self._new_bus(BusSettings() if bus is None else bus, seed)
        self._node = self.bus.node(_SIMULATOR)
        self._node.start()
        self._node.serve_faults(self._take_fault)
        self._poses = PosePublisher(self._node)

        self.links = LinkBank(self.emulator, fleet, vehicles, self.clock_ns, seed=seed)
        self._pipeline = CompiledPipeline(is_wanted=is_compiled)
        self.agents = {
            name: AgentShell(
                fleet, name, link=link, bus=self.bus, pipeline_step=self._pipeline.step
            )
            for name, link in zip(self.names, self.links.links, strict=True)
        }

        # the node that sends GNSS corrections; None if the fleet file has no corrections
        self.base: BaseStation | None = None
        if fleet.corrections is not None:
            self.base = _base_station(fleet, self.bus)

        # planned calls, as a heap: the time of the call [ns since the start], a number that keeps
        # the order of calls at the same time, and the function
        self._planned: list[tuple[int, int, Callable[[], object]]] = []
        self._count = itertools.count()

        self._bus_faults: dict[str, _BusFault] = {}  # active faults of the bus by vehicle

    def _new_bus(self, settings: BusSettings, seed: int) -> SimBus:
        """Return a bus with these settings, to which the fleet's radio adds delays and losses."""
        radio = None
        if self.fleet.radio is not None:
            radio = (self.fleet.radio, frozenset(self.names))
        return SimBus(settings.over(self.fleet.radio), self.clock_ns, seed=seed, radio=radio)

    def clock_ns(self) -> int:
        """Return the simulated time [ns], which is the monotonic clock of all nodes."""
        return EPOCH_NS + self._vehicles.steps * STEP_NS

    @property
    def now_ns(self) -> int:
        """The simulated time, as :meth:`clock_ns` returns it."""
        return self.clock_ns()

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return self.emulator.time_s

    def state_parts(self) -> tuple[object, ...]:
        """Return the objects that together hold all state of the simulation."""
        parts = (self.emulator, self._broadcast, self.links, self.bus, self._poses, self.agents)
        if self.base is None:
            return parts
        return (*parts, self.base)

    def at(self, time_s: float, function: Callable[[], object]) -> None:
        """Call ``function`` before the first step at or after ``time_s``.

        If that time [s since the start] has already passed, the next step calls it.
        """
        heapq.heappush(self._planned, (round(time_s * 1e9), next(self._count), function))

    def inject(self, fault: Fault) -> Fault:
        """Plan a fault of emulator, link, motion capture, bus or agent; return it.

        Raises:
            FaultError: the fault is impossible.
        """
        refuse_absent_source(self.emulator.check(fault), self.fleet)
        return self.emulator.inject(fault)

    def _take_fault(
        self, order: FaultOrder | Malformed, reply: Callable[[OrderReply], None]
    ) -> None:
        reply(answer_fault(self.emulator, self.fleet, order))

    def _change_outside(self, fault: Fault, is_on: bool) -> None:
        """Begin or end a fault of something outside the emulator: the bus, an agent, the base."""
        if fault.name in ("agent_dead", "agent_hang"):
            self._change_agent(self.agents[fault.vehicle], fault.name, is_on)
            return
        if fault.name == "base_moved":
            east_m = 0.0
            if is_on:
                east_m = fault.number("east_m")
            if self.base is not None:
                self.base.move(east_m)
            return
        if is_on:
            self._bus_faults[fault.vehicle] = _BusFault(fault, [])
            self._extend_bus_faults()
            return
        _, others = self._bus_faults.pop(fault.vehicle)
        for other in others:
            self._end_connection_fault(fault, other)

    def _extend_bus_faults(self) -> None:
        """Apply the active faults of the bus to nodes that have joined it meanwhile."""
        for fault, others in self._bus_faults.values():
            for name in self.bus.nodes:
                if name not in others and self._concerns(fault, name):
                    others.append(name)
                    self._begin_connection_fault(fault, name)

    def _begin_connection_fault(self, fault: Fault, other: str) -> None:
        """Begin a fault of the connection of two nodes."""
        if fault.name == "bus_cut":
            self.bus.cut(fault.vehicle, other)
            return
        usual = self.bus.settings
        # of what the bus does not lose anyway
        further_loss = (1.0 - usual.loss) * fault.number("share")
        delay_s = usual.delay_s + fault.number("delay_s")
        quality = replace(
            usual,
            loss=usual.loss + further_loss,
            delay_s=min(delay_s, LONGEST_BUS_DELAY_S),
        )
        self.bus.set_link(fault.vehicle, other, quality)

    def _end_connection_fault(self, fault: Fault, other: str) -> None:
        """End a fault of the connection of two nodes, unless the other one has the same fault."""
        fault_of_other = self._bus_faults.get(other)
        if fault_of_other is not None:
            is_same_kind = fault_of_other.fault.name == fault.name
            if is_same_kind and fault.vehicle in fault_of_other.others:
                self._begin_connection_fault(fault_of_other.fault, fault.vehicle)
                return

        if fault.name == "bus_cut":
            self.bus.heal((fault.vehicle, other))
        else:
            self.bus.reset_link(fault.vehicle, other)

    def _change_agent(self, agent: AgentShell, fault_name: str, is_on: bool) -> None:
        """Begin or end a fault of an agent's process."""
        if fault_name == "agent_dead":
            if is_on:
                agent.kill()
            else:
                agent.start()
        elif is_on:
            agent.hang()
        else:
            agent.resume()

    def _concerns(self, fault: Fault, other: str) -> bool:
        """Return whether a fault of the bus acts on the faulty vehicle's connection to a node."""
        if other in (fault.vehicle, _SIMULATOR):
            return False

        which = "all"
        if fault.name == "bus_cut":
            which = fault.word("others")
        if which == "all":
            return True
        if which == "vehicles":
            return other in self.agents
        return other not in self.agents

    def step(self) -> None:
        """Advance by 4 ms."""
        while self._planned:
            due_ns, _, function = self._planned[0]
            if due_ns > self.now_ns - EPOCH_NS:
                break
            heapq.heappop(self._planned)
            function()

        self.emulator.step()
        self.links.step()

        steps = self.emulator.world.vehicles.steps
        if steps % TRUTH_EVERY_STEPS == 0:
            self._publish()
        if self._bus_faults:
            self._extend_bus_faults()
        self.bus.deliver()
        if steps % TICK_STEPS == 0:
            self._tick_agents()

    def _tick_agents(self) -> None:
        """Let all agents receive, and then let all tick.

        Messages that an agent publishes in its tick reach the others before their next tick.
        """
        now_ns = self.now_ns
        for agent in self.agents.values():
            if agent.is_ticking:
                agent.receive(now_ns)

        ticking = [agent for agent in self.agents.values() if agent.is_ticking]
        self._pipeline.begin_tick([agent.period_ns(now_ns) for agent in ticking])
        for agent in ticking:
            agent.tick(now_ns)

    def _publish(self) -> None:
        """Publish what the motion capture sees, and the ground truth."""
        poses, truths = self._broadcast.messages()
        for pose in poses:
            self._poses.publish(pose)

        for truth in truths:
            for _, on_message in self.bus.subscribers.get((Topic.TRUTH, "*"), ()):
                # the truth is there to judge the flight, so no fault of the bus delays or loses it
                on_message(Topic.TRUTH, truth.vehicle, truth)


def _base_station(fleet: FleetConfig, bus: SimBus) -> BaseStation:
    """Return the node that sends GNSS corrections to this fleet."""
    # Import here, because most fleets have no corrections and this module needs an extra library.
    from sitl.lockstep.base_station import BaseStation

    return BaseStation(fleet, bus)
