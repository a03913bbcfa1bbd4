"""Agents' cores, emulated vehicles, motion capture and bus, advanced together by physics steps of 4
ms.

One step, always in this order: what was planned for this time, physics and autopilots, links,
motion capture and ground truth, the bus, and every fifth step the agents. All agents tick at the
same instant: what a neighbour tells is then one whole period old when it is used, the worst case of
a real fleet, whose ticks lie anywhere.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from dataclasses import replace

from onboard.bus.pose_publisher import PosePublisher
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig
from sitl.emulator.mocap import MocapSettings
from sitl.faults.catalogue import Fault
from sitl.lockstep.agents import AgentShell
from sitl.lockstep.bus import SimBus
from sitl.lockstep.connections import BusSettings
from sitl.lockstep.link import LinkBank
from sitl.lockstep.pipeline_rows import CompiledPipeline
from sitl.physics.vehicle import STEP_S
from sitl.server import TRUTH_EVERY_STEPS, Broadcast, answer_fault, emulator_of

STEP_NS = round(STEP_S * 1e9)
EPOCH_NS = 1_000_000_000  # zero means never, to everybody
TICK_STEPS = 5
_SIMULATOR = "sitl"


class Simulation:
    """A fleet without its ground.

    Args:
        fleet: the fleet file; all its enabled vehicles fly.
        seed: of everything random.
        bus: quality of the connections; mocap: of the motion capture.
        is_compiled: compute the agents' passes by compiled code; the result differs by rounding.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        *,
        seed: int = 0,
        bus: BusSettings | None = None,
        mocap: MocapSettings | None = None,
        is_compiled: bool = True,
    ) -> None:
        self.fleet, self.names = fleet, fleet.enabled_names
        vehicles = [fleet.vehicles[name] for name in self.names]
        self.emulator = emulator_of(fleet, vehicles, seed=seed)
        self._vehicles = self.emulator.world.vehicles
        self._broadcast = Broadcast(
            self.emulator,
            vehicles,
            mocap,
            seed=seed,
            boot_id=1,
            stamp_ns=lambda time_s: EPOCH_NS + round(time_s * 1e9),
        )
        radio = None if fleet.radio is None else (fleet.radio, frozenset(self.names))
        self.bus = SimBus(
            (bus or BusSettings()).over(fleet.radio), self.clock_ns, seed=seed, radio=radio
        )
        self._node = self.bus.node(_SIMULATOR)
        self._node.start()
        self._poses = PosePublisher(self._node)
        self._node.serve_faults(lambda order, reply: reply(answer_fault(self.emulator, order)))
        self.links = LinkBank(self.emulator, vehicles, self.clock_ns, seed=seed)
        self._pipeline = CompiledPipeline(is_wanted=is_compiled)
        self.agents = {
            name: AgentShell(
                fleet, name, link=link, bus=self.bus, pipeline_step=self._pipeline.step
            )
            for name, link in zip(self.names, self.links.links, strict=True)
        }
        self.emulator.outside = self._change_outside
        self._planned: list[tuple[int, int, Callable[[], object]]] = []
        self._count = itertools.count()

    def clock_ns(self) -> int:
        """Return the simulated time on everybody's monotonic clock."""
        return EPOCH_NS + self._vehicles.steps * STEP_NS

    @property
    def now_ns(self) -> int:
        """The same."""
        return self.clock_ns()

    @property
    def time_s(self) -> float:
        """Simulated seconds since the start."""
        return self.emulator.time_s

    def at(self, time_s: float, function: Callable[[], object]) -> None:
        """Call ``function`` before the first step at or after ``time_s``; at once when that has
        passed already.
        """
        heapq.heappush(self._planned, (round(time_s * 1e9), next(self._count), function))

    def inject(self, fault: Fault) -> Fault:
        """Plan a fault of emulator, link, motion capture, bus or agent; FaultError when that is
        impossible.
        """
        return self.emulator.inject(fault)

    def _change_outside(self, fault: Fault, is_on: bool) -> None:
        """Begin or end a fault of the bus or of an agent."""
        if fault.name in ("agent_dead", "agent_hang"):
            agent = self.agents[fault.vehicle]
            if fault.name == "agent_dead":
                begin, end = agent.kill, agent.start
            else:
                begin, end = agent.hang, agent.resume
            if is_on:
                begin()
            else:
                end()
            return

        which = fault.word("others") if fault.name == "bus_cut" else "all"
        others = [name for name in self.bus.nodes if name not in (fault.vehicle, _SIMULATOR)]
        for other in others:
            is_meant = which == "all" or (which == "vehicles") == (other in self.agents)
            if not is_meant:
                continue

            if fault.name == "bus_cut" and is_on:
                self.bus.cut(fault.vehicle, other)
            elif fault.name == "bus_cut":
                self.bus.heal((fault.vehicle, other))
            elif is_on:
                quality = replace(self.bus.settings, loss=fault.number("share"))
                quality = replace(quality, delay_s=quality.delay_s + fault.number("delay_s"))
                self.bus.set_link(fault.vehicle, other, quality)
            else:
                self.bus.reset_link(fault.vehicle, other)

    def step(self) -> None:
        """Advance by 4 ms."""
        while self._planned and self._planned[0][0] <= self.now_ns - EPOCH_NS:
            heapq.heappop(self._planned)[2]()
        self.emulator.step()
        self.links.step()
        steps = self.emulator.world.vehicles.steps
        if steps % TRUTH_EVERY_STEPS == 0:
            self._publish()
        self.bus.deliver()
        if steps % TICK_STEPS == 0:
            self._tick_agents()

    def _tick_agents(self) -> None:
        """Let all agents receive, and then tick: what one publishes the others hear later."""
        now_ns = self.now_ns
        for agent in self.agents.values():
            if agent.is_ticking:
                agent.receive(now_ns)

        ticking = [agent for agent in self.agents.values() if agent.is_ticking]
        self._pipeline.begin_tick([agent.period_ns(now_ns) for agent in ticking])
        for agent in ticking:
            agent.tick(now_ns)

    def _publish(self) -> None:
        poses, truths = self._broadcast.messages()
        for pose in poses:
            self._poses.publish(pose)
        for truth in truths:
            for _, on_message in self.bus.subscribers.get((Topic.TRUTH, "*"), ()):
                # a judge's view: no fault of the bus touches it
                on_message(Topic.TRUTH, truth.vehicle, truth)
