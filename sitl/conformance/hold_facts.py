"""Facts of commands to a vehicle in Hold: take-offs in the air, home, and the geofence."""

from __future__ import annotations

import math
from typing import Any

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import FactReport, facts
from sitl.conformance.hover import grounded
from sitl.conformance.vehicle_client import (
    ARM,
    ARMED,
    LAND,
    MODES,
    REQUEST,
    TAKEOFF,
    Stuck,
    VehicleClient,
    common_id,
)

_SET_HOME = 179
_REPOSITION = 192
_HOLD_ACTION = 2  # value of GF_ACTION
_FENCE_M = 5.0  # GF_MAX_HOR_DIST
_GOAL_M = 20.0  # distance of a goal beyond the fence
_CLIMB_M = 4.0  # height of that goal above home, so that the landing lasts longer than _LOSS_S
_LOSS_S = 5.0  # COM_DL_LOSS_T
_NAN = math.nan
_METRES_PER_DEGREE = 111_195.0  # of latitude
FACTS = facts("hold", "facts")


def run(client: VehicleClient, report: FactReport) -> None:
    """Take off, send commands in Hold, pass the geofence, and land by a request of the user."""
    client.greet(as_ground_station=True)
    grounded(client)
    client.wait(1.2)
    client.interval("LOCAL_POSITION_NED", 30.0)
    client.command(TAKEOFF, _NAN, 0.0, 0.0, _NAN, _NAN, _NAN, _NAN)
    if client.command(ARM, 1.0) != "ACCEPTED":
        raise Stuck("it did not arm in AUTO.TAKEOFF")
    _wait_for_hold(client)

    _take_off_again(client, report)
    _set_home(client, report)
    _pass_fence(client, report)
    _land_unheard(client, report)

    client.greet(as_ground_station=True)
    client.wait(30.0, lambda: not client.is_armed)
    client.command(_SET_HOME, 1.0)
    client.interval("LOCAL_POSITION_NED", 0.0)


def _wait_for_hold(client: VehicleClient) -> None:
    """Wait until a take-off has become Hold, and the vehicle rests."""
    client.next_heartbeat(2)
    if not client.wait(15.0, lambda: client.mode == "AUTO.LOITER"):
        raise Stuck("its take-off did not end in AUTO.LOITER")
    client.wait(3.0)


def _take_off_again(client: VehicleClient, report: FactReport) -> None:
    before = client.newest("LOCAL_POSITION_NED")
    client.command(TAKEOFF, _NAN, 0.0, 0.0, _NAN, _NAN, _NAN, _NAN)
    _wait_for_hold(client)
    after = client.newest("LOCAL_POSITION_NED")
    report.add("hold.takeoff", before.z - after.z)

    since_s = client.now_s
    client.command(TAKEOFF, _NAN, 0.0, 0.0, _NAN, _NAN, _NAN, 0.0)
    _wait_for_hold(client)
    report.add("hold.takeoff-below", after.z - client.newest("LOCAL_POSITION_NED").z)
    report.add("hold.takeoff-below-text", client.quote("Already", since_s))


def _set_home(client: VehicleClient, report: FactReport) -> None:
    report.add("home.here", client.command(_SET_HOME, 1.0))
    home = _home(client)
    position = client.newest("LOCAL_POSITION_NED")
    moved_m = math.dist((home.x, home.y, home.z), (position.x, position.y, position.z))
    report.add("home.here-distance", moved_m)


def _home(client: VehicleClient) -> Any:
    """Request HOME_POSITION, and return it."""
    since_s = client.now_s
    client.command(REQUEST, float(common_id("HOME_POSITION")))
    client.wait(1.0, lambda: bool(client.received.of("HOME_POSITION", since_s)))
    return client.newest("HOME_POSITION")


def _pass_fence(client: VehicleClient, report: FactReport) -> None:
    home = _home(client)
    goal = (
        home.latitude * 1e-7 + _GOAL_M / _METRES_PER_DEGREE,
        home.longitude * 1e-7,
        home.altitude * 1e-3 + _CLIMB_M,
    )
    client.params.set("GF_ACTION", _HOLD_ACTION)
    client.params.set("GF_MAX_HOR_DIST", _FENCE_M)
    since_s = client.now_s
    report.add("fence.goal", client.command(_REPOSITION, -1.0, 1.0, 0.0, _NAN, *goal))
    client.wait(0.5)
    report.add("fence.goal-text", client.quote("Reposition", since_s))

    # The fence appears when the vehicle is on its way.
    client.params.set("GF_MAX_HOR_DIST", 0.0)
    client.command(_REPOSITION, -1.0, 1.0, 0.0, _NAN, *goal)
    client.params.set("GF_MAX_HOR_DIST", _FENCE_M)
    client.wait(12.0)
    client.next_heartbeat()
    report.add("fence.breach", f"{client.mode} {client.status}")
    position = client.newest("LOCAL_POSITION_NED")
    report.add("fence.stop", math.dist((home.x, home.y), (position.x, position.y)))


def _land_unheard(client: VehicleClient, report: FactReport) -> None:
    """Land out of the failsafe of the fence, and fall silent as a ground station."""
    client.params.set("GF_MAX_HOR_DIST", 2.5)  # now it is surely beyond, and does not drift past it
    client.wait(1.0)
    client.command(LAND)
    client.next_heartbeat(2)
    report.add("fence.takeover", f"{client.mode} {client.status}")

    client.params.set("GF_MAX_HOR_DIST", 0.0)  # drifting past the fence again would end the landing
    client.params.set("COM_DL_LOSS_T", _LOSS_S)
    client.params.set("NAV_DLL_ACT", 1)
    client.heartbeat_duty.act = None
    silent_s = client.now_s
    client.wait(_LOSS_S + 2.0)

    modes: set[str] = set()
    for packet in client.received.of("HEARTBEAT", silent_s):
        if packet.message.base_mode & ARMED:
            modes.add(MODES.get(packet.message.custom_mode, "?"))
    report.add("land.ground-lost", ", ".join(sorted(modes)))


FACT_GROUP = FactGroup("commands in hold", FACTS, run)
