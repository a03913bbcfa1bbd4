"""What an emulator says on the bus, and the orders for faults that it takes from there."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from onboard.bus.codec import Malformed
from onboard.bus.schema import FaultOrder, MocapPose, OrderReply, Truth
from onboard.config.fleet import FleetConfig, Person, Vehicle
from onboard.config.people import body_of
from sitl.emulator.emulator import Emulator
from sitl.emulator.mocap import Mocap, MocapSettings, Pose
from sitl.emulator.walk import position_at
from sitl.faults.catalogue import Fault, FaultError
from sitl.fleet_faults import refuse_absent_source

TRUTH_EVERY_STEPS = 5  # every tick of the agents, 20 ms
_PEOPLE_SEED = 1  # added to the seed, so that people get different noise from the vehicles
_LONGEST_WAIT_S = 1e6  # longest time until an ordered fault begins


def answer_fault(
    emulator: Emulator, fleet: FleetConfig, order: FaultOrder | Malformed
) -> OrderReply:
    """Plan the fault of an order; return the reply with the reason of a refusal."""
    if isinstance(order, Malformed):
        return OrderReply(
            order_id="", vehicle="", is_accepted=False, reason=f"This is no fault: {order.reason}."
        )

    fault = Fault(
        name=order.fault,
        vehicle=order.vehicle,
        at_s=emulator.time_s + order.after_s,
        duration_s=order.duration_s,
        parameters=order.parameters,
    )
    try:
        if not 0.0 <= order.after_s <= _LONGEST_WAIT_S:
            raise FaultError(
                f"{order.fault}: after_s is {order.after_s:.0f}; "
                f"give 0 to {_LONGEST_WAIT_S:.0f} seconds."
            )
        accepted = emulator.check(fault)
        refuse_absent_source(accepted, fleet)
        if not order.is_rehearsal:
            accepted = emulator.inject(fault)
    except FaultError as error:
        return OrderReply(
            order_id=order.order_id, vehicle=order.vehicle, is_accepted=False, reason=str(error)
        )
    return OrderReply(
        order_id=order.order_id, vehicle=order.vehicle, is_accepted=True, reason=accepted.sentence
    )


class Broadcast:
    """Poses of an emulated motion capture and ground truth, as messages of the bus.

    Args:
        emulator: emulator with the vehicles.
        vehicles: vehicles of the emulator, in its order.
        mocap: quality of the motion capture.
        people: people in the fleet file; the motion capture sees those that have a walk.
        seed: seed of the noise of the motion capture.
        boot_id: boot id of the sender.
        stamp_ns: function from simulated seconds to the stamp of a message.
        source: node of the sender, if receivers have other clocks.
        truth_offset_m: offset of the published true positions, to prove that no flight depends on
            them.
    """

    def __init__(
        self,
        emulator: Emulator,
        vehicles: Sequence[Vehicle],
        mocap: MocapSettings | None,
        *,
        people: Mapping[str, Person] = {},
        seed: int,
        boot_id: int,
        stamp_ns: Callable[[float], int],
        source: str = "",
        truth_offset_m: float = 0.0,
    ) -> None:
        self._emulator = emulator
        self._names = [vehicle.name for vehicle in vehicles]
        self._bodies = [vehicle.mocap_body or vehicle.name for vehicle in vehicles]
        self._mocap = Mocap(len(vehicles), mocap, seed=seed, faults=emulator.disturbances.mocap)

        self._people = {
            body_of(name, person): person for name, person in people.items() if person.walk_enu_m
        }
        self._people_mocap = Mocap(len(self._people), mocap, seed=seed + _PEOPLE_SEED)
        self._boot_id = boot_id
        self._stamp_ns = stamp_ns
        self._source = source
        self._truth_offset_m = truth_offset_m
        self._sequence = 0

    def messages(self) -> tuple[list[MocapPose], list[Truth]]:
        """Return the poses that the motion capture delivers now, and the truth of every vehicle."""
        emulator = self._emulator
        position, velocity, attitude = emulator.world.truth_enu()
        delivered = self._mocap.step(emulator.time_s, position, attitude)
        poses = [self._pose_message(pose, self._bodies) for pose in delivered]
        poses += self._poses_of_people(emulator.time_s)

        states = emulator.world.vehicles.states
        motion = emulator.world.vehicles.motion
        stamp_ns = self._stamp_ns(emulator.time_s)
        shown_position = position + self._truth_offset_m
        truths = [
            Truth(
                vehicle=name,
                stamp_ns=stamp_ns,
                position_enu_m=tuple(shown_position[index].tolist()),
                velocity_enu_m_s=tuple(velocity[index].tolist()),
                quaternion_enu_flu_wxyz=tuple(attitude[index].tolist()),
                is_on_ground=bool(states.on_ground[index]),
                is_collided=index in emulator.world.collided,
                touchdowns=int(motion["touchdowns"][index]),
                touchdown_m_s=float(motion["touchdown_speed"][index]),
                had_thrust=bool(motion["touchdown_powered"][index]),
                is_flown_by_agent=emulator.follows_setpoints(index),
                contacts_known_by=self._boot_id,
            )
            for index, name in enumerate(self._names)
        ]
        return poses, truths

    def _poses_of_people(self, time_s: float) -> list[MocapPose]:
        if not self._people:
            return []
        walkers = self._people.values()
        position = np.array([position_at(p.walk_enu_m, p.walk_m_s, time_s) for p in walkers])
        attitude = np.tile([1.0, 0.0, 0.0, 0.0], (len(self._people), 1))
        delivered = self._people_mocap.step(time_s, position, attitude)
        bodies = list(self._people)
        return [self._pose_message(pose, bodies) for pose in delivered]

    def _pose_message(self, pose: Pose, bodies: Sequence[str]) -> MocapPose:
        self._sequence += 1
        return MocapPose(
            body=bodies[pose.index],
            boot_id=self._boot_id,
            sequence=self._sequence,
            stamp_ns=self._stamp_ns(pose.time_s),
            is_tracked=pose.is_tracked,
            position_enu_m=pose.position_enu_m,
            quaternion_enu_flu_wxyz=pose.quaternion_enu_flu_wxyz,
            source=self._source,
        )
