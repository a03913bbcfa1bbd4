"""A core in virtual time, over a vehicle that does at once what it is told and a PX4 with a slow
heartbeat.
"""

from __future__ import annotations

import copy
import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import numpy as np
from msgspec.structs import replace

from onboard import agent_commands, agent_inputs
from onboard.agent.core import AgentCore
from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import (
    Event,
    MocapPose,
    Order,
    OrderKind,
    OrderReply,
    StateMessage,
    Telemetry,
)
from onboard.bus.topics import Topic
from onboard.config.fleet import FleetConfig, fleet_from_mapping
from onboard.constants import GRAVITY_M_S2
from onboard.frames import Quaternion, body_up, wrap_rad, yaw_from_quaternion
from onboard.types import AttitudeSetpoint
from tests.oracles.rotation import quaternion_from_yaw, quaternion_multiply

DT_NS = 20_000_000
HOVER = 0.5
MAX_TURN_RAD = 0.06  # in a tick


def fleet(
    names: tuple[str, ...] = ("mav0", "mav1"),
    enabled: object = "scan",
    px4_params: dict[str, float] | None = None,
    ground_lost_land_s: float = 60.0,
) -> FleetConfig:
    """A small fleet; neighbours need not be there."""
    vehicles = {
        name: {
            "system_id": place + 1,
            "start_enu_m": [1.5 * place, 0.0, 0.0],
            "agent": f"tcp/127.0.0.1:{7460 + place}",
            "autopilot": f"udpin://127.0.0.1:{14540 + place}",
            "enabled": True if place == 0 else enabled,
        }
        for place, name in enumerate(names)
    }
    return fleet_from_mapping(
        {
            "schema": 1,
            "fleet": {
                "name": "rig",
                "ground_lost_land_s": ground_lost_land_s,
                "geofence_m": {"x": [-4.0, 4.0], "y": [-4.0, 4.0], "z": [0.0, 3.0]},
            },
            "defaults": {"px4_params": px4_params or {}},
            "vehicles": vehicles,
        }
    )


@dataclass
class Rig:
    """``run`` advances; switches break things; ``sent`` and ``events`` hold the results."""

    core: AgentCore = field(default_factory=lambda: AgentCore(fleet(), "mav0", boot_id=7))
    heading_error_rad: float = 0.0
    accepts_offboard: bool = True
    accepts_arm: bool = True
    hears_kill: bool = True
    sees_ground: bool = True  # False: PX4 does not notice that it is down
    obeys: bool = True  # False: PX4 takes setpoints and keeps to the last one that it obeyed
    has_mocap: bool = True
    has_autopilot: bool = True
    has_bus: bool = True  # False: poses come by another wire, nothing else is heard
    has_lift: bool = True  # False: propellers broken, as after a collision
    landed_report: Landed | None = None  # what PX4 reports instead of what it sees
    has_landed_reports: bool = True  # False: the last one stays
    floor_m: float = 0.0
    height_error_m: float = 0.0  # of what PX4 takes for its height
    battery_frac: float = 0.9
    sends_battery: bool = True
    has_sticks: bool = False  # PX4 hears a pilot's
    sends_accuracy: bool = True
    sends_heartbeat: bool = True
    has_fix: bool = True  # of satellites
    now_ns: int = 1_000_000_000
    position: np.ndarray = field(default_factory=lambda: np.zeros(3))
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(3))
    is_armed: bool = False
    mode: str = "HOLD"
    sent: list[tuple[int, agent_commands.Command]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    telemetry: Telemetry | None = None
    state: StateMessage | None = None
    tick_count: int = 0
    has_flown: bool = False
    setpoint: AttitudeSetpoint | None = None  # last one that PX4 obeys
    snapshot: Snapshot = field(default_factory=lambda: Snapshot(px4_version=(1, 17)))
    after_move: Callable[[], None] = lambda: None  # changes the motion of a tick
    _heartbeat: tuple[int, bool, str] = (0, False, "")
    _ids: itertools.count = field(default_factory=itertools.count)
    _on_ground_ns: int = 0
    _last_setpoint_ns: int = 0

    def __post_init__(self) -> None:
        self.core.preflight.is_warm = True
        self.core.handle(agent_inputs.ParamsRead(()), self.now_ns)
        self.core.handle(agent_inputs.NodeChanged("ground-1", True), self.now_ns)

    # -- the world --

    def run(self, seconds: float) -> None:
        """That much virtual time."""
        for _ in range(round(seconds / 0.02)):
            self.step()

    def until(self, wanted: str, timeout_s: float = 30.0) -> None:
        """Until the flight is in a state; fails when it takes too long."""
        for _ in range(round(timeout_s / 0.02)):
            if self.core.flight.state == wanted:
                return
            self.step()
        raise AssertionError(
            f"still {self.core.flight.state} ({self.core.flight.reason}), wanted {wanted}"
        )

    def step(self) -> None:
        """One tick of 20 ms."""
        self.now_ns += DT_NS
        self.tick_count += 1

        if self.has_autopilot:
            self._run_px4()
        self.core.handle(agent_inputs.SnapshotReceived(self.snapshot), self.now_ns)

        heard_ns = self.core.neighbours.last_heard_ns
        if self.has_mocap:
            self.pose()
        if not self.has_bus:
            self.core.neighbours.last_heard_ns = heard_ns

        self.take(self.core.tick(self.now_ns))
        self.move()
        self.after_move()

    def _run_px4(self) -> None:
        """PX4's part of a tick: it sees the ground, disarms after a landing, and reports."""
        now = self.now_ns
        if self.sends_heartbeat and now - self._heartbeat[0] >= 1_000_000_000:
            self._heartbeat = (now, self.is_armed, self.mode)

        on_ground = self.position[2] <= self.floor_m + 1e-6
        if not on_ground:
            self._on_ground_ns = 0
        elif not self._on_ground_ns:
            self._on_ground_ns = now

        stood_ns = now - self._on_ground_ns
        is_sure = not self.is_armed or stood_ns > 2_200_000_000
        landed = on_ground and self.sees_ground and is_sure
        if landed and self.is_armed and self.has_flown and stood_ns > 4_200_000_000:
            self.is_armed = False

        before = self.snapshot
        self.snapshot = replace(
            before,
            last_packet_ns=now,
            attitude_ns=now,
            position_local_ned_m=(
                float(self.position[1]),
                float(self.position[0]),
                float(-self.position[2]) - self.height_error_m,
            ),
            velocity_local_ned_m_s=(
                float(self.velocity[1]),
                float(self.velocity[0]),
                float(-self.velocity[2]),
            ),
            local_position_ns=now,
            heartbeat_ns=self._heartbeat[0],
            is_armed=self._heartbeat[1],
            mode=self._heartbeat[2],
            **self._landed(landed or not self.has_flown),
            battery_frac=self.battery_frac,
            battery_voltage_v=15.0,
            has_fix=self.has_fix,
            fix_ns=now,
            position_accuracy_ns=now if self.sends_accuracy else before.position_accuracy_ns,
            battery_ns=now if self.sends_battery else before.battery_ns,
            sticks_ns=now if self.has_sticks else before.sticks_ns,
            sticks_before_ns=before.sticks_ns if self.has_sticks else before.sticks_before_ns,
        )

    def _landed(self, is_landed: bool) -> dict[str, object]:
        if not self.has_landed_reports:
            return {}
        seen = Landed.ON_GROUND if is_landed else Landed.IN_AIR
        return {"landed": self.landed_report or seen, "landed_ns": self.now_ns}

    def carry(self, *position: float, speed_m_s: float = 1.5) -> None:
        """Carry the vehicle to a position by hand, whatever it does itself."""
        there = np.array(position)
        while np.linalg.norm(there - self.position) > 1e-6:
            left = there - self.position
            size = float(np.linalg.norm(left))

            begin = self.position.copy()
            velocity = left / size * min(speed_m_s, size / 0.02)
            self.step()

            self.position = begin + 0.02 * velocity
            self.velocity = velocity
        self.velocity = np.zeros(3)

    def pose(self, **changes: object) -> None:
        """One mocap sample of now."""
        x, y, z = self.position.tolist()
        # no two samples of a tracked body are the same
        position = (x, y, z + 1e-6 * (self.tick_count % 2))
        sample = MocapPose(
            body="mav0",
            boot_id=1,
            sequence=self.tick_count,
            stamp_ns=self.now_ns,
            is_tracked=True,
            position_enu_m=position,
            quaternion_enu_flu_wxyz=self._true(self.snapshot.quaternion_enu_flu_wxyz),
        )

        sample = msgspec.structs.replace(sample, **changes)
        self.take(self.core.handle(agent_inputs.PoseReceived(sample, self.now_ns), self.now_ns))

    def take(self, commands: list[agent_commands.Command]) -> None:
        """Let PX4 and the listeners act on commands."""
        for command in commands:
            self.sent.append((self.now_ns, command))
            match command:
                case agent_commands.SendAttitude(setpoint):
                    self.setpoint = setpoint if self.obeys else self.setpoint
                    self._last_setpoint_ns = self.now_ns
                case agent_commands.SetOffboard() if self.accepts_offboard:
                    self.mode = "OFFBOARD"
                case agent_commands.Arm() if self.accepts_arm and self.mode == "OFFBOARD":
                    self.is_armed = True
                case agent_commands.Disarm() if self.position[2] <= self.floor_m + 1e-6:
                    self.is_armed = False
                case agent_commands.Kill() if self.hears_kill:
                    self.is_armed = False
                case agent_commands.RequestHeartbeat():
                    # it answers after the request
                    self._heartbeat = (self.now_ns + 1, self.is_armed, self.mode)
                case agent_commands.Px4Land():
                    self.mode = "LAND"
                case agent_commands.Publish(Topic.EVENT, Event() as event):
                    self.events.append(event)
                case agent_commands.Publish(Topic.TELEMETRY, Telemetry() as telemetry):
                    self.telemetry = telemetry
                case agent_commands.Publish(Topic.STATE, StateMessage() as state):
                    self.state = state

    def _true(self, believed: Quaternion) -> Quaternion:
        """PX4's attitude with the error of its heading taken out."""
        return quaternion_multiply(quaternion_from_yaw(self.heading_error_rad), believed)

    def _turned(self, wanted: Quaternion) -> Quaternion:
        """The attitude of this tick: tilted at once, but turned no faster than a vehicle can."""
        left_rad = wrap_rad(
            yaw_from_quaternion(wanted) - yaw_from_quaternion(self.snapshot.quaternion_enu_flu_wxyz)
        )
        missing_rad = left_rad - min(max(left_rad, -MAX_TURN_RAD), MAX_TURN_RAD)
        return quaternion_multiply(wanted, quaternion_from_yaw(-missing_rad))

    def move(self) -> None:
        """Advance position and velocity by one tick."""
        acceleration = np.array([0.0, 0.0, -GRAVITY_M_S2])
        is_offboard = self.is_armed and self.mode == "OFFBOARD"
        if is_offboard and self.setpoint is not None and self.has_lift:
            believed = self._turned(self.setpoint.quaternion_wxyz)
            thrust_m_s2 = self.setpoint.thrust_frac / HOVER * GRAVITY_M_S2
            acceleration += thrust_m_s2 * np.array(body_up(self._true(believed)))
            self.snapshot = replace(self.snapshot, quaternion_enu_flu_wxyz=believed)
        elif self.is_armed and self.mode == "LAND":
            acceleration = np.array([0.0, 0.0, -0.5]) - self.velocity * 1.0

        self.velocity = self.velocity + 0.02 * acceleration
        self.position = self.position + 0.02 * self.velocity

        if self.position[2] <= self.floor_m:
            self.position[2] = self.floor_m
            self.velocity = np.zeros(3)
        elif self.position[2] > self.floor_m + 0.05:
            self.has_flown = True

    # -- orders --

    def order(self, kind: OrderKind, **fields: object) -> OrderReply:
        """Send an order and return the answer; its sender has heard the newest telemetry."""
        if self.telemetry is not None:
            fields.setdefault("heard_boot_id", self.telemetry.boot_id)
            fields.setdefault("heard_ns", self.telemetry.stamp_ns)

        order = Order(
            order_id=str(fields.pop("order_id", f"o{next(self._ids)}")),
            author="tester",
            kind=kind,
            stamp_ns=self.now_ns,
            deadline_ns=int(fields.pop("deadline_ns", self.now_ns + 10**9)),  # type: ignore[call-overload]
            **fields,  # type: ignore[arg-type]
        )

        commands = self.core.handle(agent_inputs.OrderReceived(order), self.now_ns)
        self.take(commands)

        (reply,) = [
            command.reply for command in commands if isinstance(command, agent_commands.Reply)
        ]
        return reply

    def fly(self) -> None:
        """Up to a hover at 1 m."""
        self.until("ready")
        assert self.order("takeoff", height_m=1.0).is_accepted
        self.until("flying")

    def outcomes(self) -> dict[str, str]:
        """Ends of orders so far."""
        return {event.order_id: event.order_outcome for event in self.events if event.order_id}

    def count(self, kind: type, since_ns: int = 0) -> int:
        """Return the number of commands of a kind that went out after a time."""
        return sum(isinstance(command, kind) for stamp, command in self.sent if stamp > since_ns)


def ready_rig() -> Rig:
    """Return a rig that is ready to take off, as after ``until("ready")``."""
    return copied(_ready())


def hovering_rig() -> Rig:
    """Return a rig that hovers at 1 m, as after ``fly``."""
    return copied(_hovering())


@functools.cache
def _ready() -> Rig:
    rig = Rig()
    rig.until("ready")
    return rig


@functools.cache
def _hovering() -> Rig:
    rig = ready_rig()
    rig.fly()
    return rig


def copied(rig: Rig) -> Rig:
    """Return a rig of its own; the commands sent so far, which nobody changes, are shared."""
    return copy.deepcopy(rig, {id(rig.sent): list(rig.sent)})
