"""Persons among the neighbours on a vehicle's page."""

from __future__ import annotations

import msgspec

from groundstation.console.vehicle_drawing import blocks
from groundstation.console.vehicle_subject import VehicleSubject
from groundstation.fleet.state import PERSON_STALE_NS, fold
from onboard.bus.schema import MocapPose, MocapPoses
from onboard.config.people import Person
from tests.groundstation.console.scenes import SteadyClient, crowd


def rows(client: SteadyClient) -> list[list[str]]:
    """The names and distances of the neighbours of v000."""
    subject = VehicleSubject(
        view=client.state.vehicles["v000"],
        index=0,
        state=client.state,
        fleet=client.fleet,
        now_ns=client.now_ns(),
        tick_samples=(),
    )
    neighbours = blocks(subject, 78)[2]
    return [strip.text.split()[:2] for strip in neighbours[2:] if strip.text.strip()]


def test_a_person_stands_among_the_neighbours_with_the_distance_to_the_circle() -> None:
    people = {"anna": Person(radius_m=0.5)}
    client = SteadyClient(msgspec.structs.replace(crowd(2, side_m=8.0), people=people))
    client.hear("v000", position_enu_m=(0.0, 0.0, 1.0))
    client.hear("v001", position_enu_m=(2.0, 0.0, 1.0))
    assert rows(client) == [["v001", "2.00"], ["anna", "-"]]

    pose = MocapPose(
        body="anna",
        boot_id=1,
        sequence=1,
        stamp_ns=client.now_ns(),
        is_tracked=True,
        position_enu_m=(0.0, -1.75, 1.7),
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    )
    client.state = fold(client.state, MocapPoses(poses=(pose,)), client.now_ns())
    assert rows(client) == [["anna", "1.25"], ["v001", "2.00"]]

    client.clock_ns += PERSON_STALE_NS
    client.hear("v001", position_enu_m=(2.0, 0.0, 1.0))
    client.hear("v000", position_enu_m=(0.0, 0.0, 1.0))
    assert rows(client) == [["v001", "2.00"], ["anna", "-"]]
