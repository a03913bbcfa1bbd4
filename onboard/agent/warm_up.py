"""Warms up an agent: a temporary core takes off with made-up data, so that no real tick is slow.

This loads all deferred imports, and makes Python and numpy allocate the memory that they keep.
"""

from __future__ import annotations

from msgspec.structs import replace

from onboard import agent_commands, agent_inputs
from onboard.agent.core import AgentCore
from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import MocapPose, Order
from onboard.config.fleet import FleetConfig
from onboard.frames import ned_from_enu
from onboard.preflight.law_refusals import refusals_of_fleet
from onboard.preflight.preflight_inputs import EMULATOR
from onboard.safety.failsafe_table import Situation
from onboard.types import TICK_S

_START_NS = 1_000_000_000  # made-up time of the first tick
_PERIOD_NS = round(TICK_S * 1e9)
_MAX_TICKS = 250
_FLYING_TICKS = 50  # the warm-up ends after this number of ticks in flight
_CLIMB_M_S = 0.4  # speed of the made-up climb


def warm_up(fleet: FleetConfig, name: str) -> bool:
    """Fly a core that is alone in its fleet; return whether it took off.

    If the preflight check refuses the take-off (outside the fence, for instance), the core stays
    on the ground.
    """
    core = AgentCore(replace(fleet, vehicles={name: fleet.vehicles[name]}), name, boot_id=0)
    core.preflight.is_warm = True
    core.handle(agent_inputs.ParamsRead(()), _START_NS)
    # a user's own law may only fly while an emulator is on the bus
    for node in ("ground-1", EMULATOR):
        core.handle(agent_inputs.NodeChanged(node, True), _START_NS)

    vehicle = _MadeUpVehicle(core)
    flying_ticks = 0
    for count in range(1, _MAX_TICKS + 1):
        vehicle.tick(_START_NS + count * _PERIOD_NS)
        if core.flight.step.situation is Situation.FLYING:
            flying_ticks += 1
        if flying_ticks == _FLYING_TICKS:
            break

    refusals_of_fleet(fleet)  # the first check on the ground finds them ready
    return flying_ticks > 0


class _MadeUpVehicle:
    """Confirms every request at once, as PX4 would; the vehicle climbs as soon as it is armed."""

    def __init__(self, core: AgentCore) -> None:
        self._core = core
        self._vehicle = core.vehicle
        self._height_m = 0.0  # above the start
        self._count = 0  # number of ticks

        global_origin = None
        origin = core.fleet.fleet.global_origin
        if origin is not None:
            global_origin = (origin.latitude_deg, origin.longitude_deg, origin.altitude_m)
        self._snapshot = Snapshot(
            battery_frac=1.0,
            battery_voltage_v=16.0,
            landed=Landed.ON_GROUND,
            global_origin=global_origin,
        )

    def tick(self, now_ns: int) -> None:
        """Run one tick: report the vehicle, order the take-off once ready, and obey the core."""
        core = self._core
        self._count += 1

        if self._snapshot.is_armed:
            self._height_m += _CLIMB_M_S * _PERIOD_NS * 1e-9
        x, y, ground_m = self._vehicle.start_enu_m
        # the position changes at each tick, because a body that never moves counts as lost by the
        # mocap
        z = ground_m + self._height_m + 1e-6 * (self._count % 2)
        self._snapshot = replace(
            self._snapshot,
            last_packet_ns=now_ns,
            attitude_ns=now_ns,
            heartbeat_ns=now_ns,
            landed_ns=now_ns,
            position_accuracy_ns=now_ns,
            local_position_ns=now_ns,
            position_local_ned_m=ned_from_enu((x, y, z)),
        )
        core.handle(agent_inputs.SnapshotReceived(self._snapshot), now_ns)
        if self._vehicle.body:
            core.handle(agent_inputs.PoseReceived(self._pose((x, y, z), now_ns), now_ns), now_ns)

        if core.flight.state == "ready" and core.flight.order is None:
            order = Order(
                order_id="warm-up",
                author="",
                kind="takeoff",
                stamp_ns=now_ns,
                deadline_ns=0,
                height_m=z + 1.0,
            )
            core.handle(agent_inputs.OrderReceived(order), now_ns)

        for command in core.tick(now_ns):
            match command:
                case agent_commands.SetOffboard():
                    self._snapshot = replace(self._snapshot, mode="OFFBOARD")
                case agent_commands.Arm():
                    self._snapshot = replace(self._snapshot, is_armed=True, landed=Landed.IN_AIR)

    def _pose(self, position_enu_m: tuple[float, float, float], now_ns: int) -> MocapPose:
        return MocapPose(
            body=self._vehicle.body or "",
            boot_id=1,
            sequence=self._count,
            stamp_ns=now_ns,
            is_tracked=True,
            position_enu_m=position_enu_m,
            quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
        )
