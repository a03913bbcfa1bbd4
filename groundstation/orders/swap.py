"""The swap of a vehicle for a spare: reasons against it, and which vehicles get a message. Pure.

The spare gets the order to stand in for the swapped vehicle, which gets the order ``disable``. A
swapped vehicle that is silent gets no order, because a dead computer is a reason to swap. Each
vehicle checks its own order once more (`onboard/flight/order_checks.py`).
"""

from __future__ import annotations

import math

from msgspec.structs import replace

from groundstation.fleet.slot_owners import slot_owner_of, stand_ins
from groundstation.fleet.state import FleetState, VehicleView
from groundstation.orders.intents import Swap
from onboard.config.fleet import FleetConfig
from onboard.config.stand_in import stand_in_refusal


def with_slot_owner(intent: Swap, state: FleetState) -> Swap:
    """Return the order with the vehicle whose spot, slots and paths the spare gets.

    Args:
        intent: order as it was written.
        state: the fleet as known now.
    """
    if intent.slot_owner:
        return intent
    return replace(intent, slot_owner=slot_owner_of(intent.swapped, state))


def names_that_hear(intent: Swap, state: FleetState, now_ns: int) -> list[str]:
    """Return which vehicles get a message: the spare, and the swapped vehicle if it is heard.

    Args:
        intent: swap whose slot owner is filled in.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].
    """
    swapped = state.vehicles.get(intent.swapped)
    if swapped is not None and swapped.is_fresh(now_ns):
        return [intent.swapped, intent.spare]
    return [intent.spare]


def swap_refusals(
    intent: Swap, fleet: FleetConfig, state: FleetState, now_ns: int
) -> dict[str, str]:
    """Return why a swap is refused, as a sentence for the vehicle that is the reason.

    Args:
        intent: swap whose slot owner is filled in.
        fleet: the fleet file.
        state: the fleet as known now.
        now_ns: the ground's monotonic clock [ns].
    """
    not_standing = _not_standing(state.vehicles[intent.swapped])
    if not_standing:
        return {intent.swapped: not_standing}

    spare = state.vehicles[intent.spare]
    sentence = _spare_refusal(intent, spare, fleet, state, now_ns)
    if sentence:
        return {intent.spare: sentence}
    return {}


def _spare_refusal(
    intent: Swap, spare: VehicleView, fleet: FleetConfig, state: FleetState, now_ns: int
) -> str:
    """Return why the spare cannot stand in for the other vehicle; empty if it can."""
    telemetry = spare.telemetry
    if telemetry is None or not spare.is_fresh(now_ns):
        sentence = f"{spare.name} is not heard: start its agent."
        if fleet.has_keys:
            sentence += f" It needs keys of its own: covey keys secure {fleet.path}."
        return sentence

    not_standing = _not_standing(spare)
    if not_standing:
        return not_standing

    own_slot_owner = slot_owner_of(spare.name, state)
    if own_slot_owner not in (spare.name, intent.slot_owner):
        return (
            f"{spare.name} stands in for {own_slot_owner} already: order swap {spare.name} "
            f"{own_slot_owner} first."
        )
    # the vehicle that has the place now
    holder = stand_ins(state).get(intent.slot_owner, intent.swapped)
    if holder not in (intent.swapped, spare.name):
        return f"{holder} has the place of {intent.slot_owner}: write swap {holder} {spare.name}."
    in_the_way = _in_the_way(intent, fleet, state, now_ns)
    if in_the_way:
        return in_the_way
    position_enu_m = telemetry.position_enu_m if telemetry.is_position_valid else None
    return stand_in_refusal(fleet, spare.name, intent.slot_owner, position_enu_m)


def _in_the_way(intent: Swap, fleet: FleetConfig, state: FleetState, now_ns: int) -> str:
    """Return a sentence if the swapped vehicle stands where the spare will land; else empty.

    The avoidance law does not avoid vehicles that stand on the ground.
    """
    position_enu_m = state.vehicles[intent.swapped].position_enu_m(now_ns)
    if position_enu_m is None or intent.slot_owner not in fleet.vehicles:
        return ""

    spot_enu_m = fleet.vehicles[intent.slot_owner].start_enu_m
    if math.dist(position_enu_m[:2], spot_enu_m[:2]) > fleet.fleet.safety_distance_m:
        return ""
    return (
        f"{intent.swapped} still stands on the spot on which {intent.spare} will land: carry it "
        f"away, by more than {fleet.fleet.safety_distance_m:g} m, then order again."
    )


def _not_standing(view: VehicleView) -> str:
    """Return a sentence if a vehicle is armed or flies; empty if it stands or was never heard."""
    telemetry = view.telemetry
    if telemetry is None or not view.is_up:
        return ""
    doing = telemetry.state if view.is_airborne else "armed"
    return f"Vehicles are swapped on the ground only, disarmed: {view.name} is {doing}."
