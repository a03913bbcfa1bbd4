"""Which vehicle has which slot, by what the vehicles say of themselves.

A slot is a take-off spot, the places in formations and the paths of one vehicle of the fleet file.
Mostly a vehicle has its own slot. A spare that stands in for another vehicle has that one's.
"""

from __future__ import annotations

from collections.abc import Callable

from onboard.bus.schema import Telemetry


def claimed_slot(telemetry: Telemetry) -> str | None:
    """Return the owner of the slot that the sender has; None if the sender is out of service."""
    if telemetry.disabled_by:
        return None
    if telemetry.stands_in_for:
        return telemetry.stands_in_for
    return telemetry.vehicle


class SlotClaims:
    """The slots of the other vehicles of one vehicle.

    Args:
        own_name: name of this vehicle.
        is_gone: returns whether a vehicle with a claim has been silent on the ground for long.
    """

    def __init__(self, own_name: str, is_gone: Callable[[str, int], bool]) -> None:
        self._own_name = own_name
        self._is_gone = is_gone
        # vehicle in service -> owner of the slot that it claims, the newest claim last
        self._claims: dict[str, str] = {}
        self._has_spares = False  # whether a vehicle claims the slot of another one

    def note(self, telemetry: Telemetry) -> None:
        """Note the slot that a vehicle claims now."""
        name = telemetry.vehicle
        slot_owner = claimed_slot(telemetry)
        if self._claims.get(name) == slot_owner:
            return

        self._claims.pop(name, None)
        if slot_owner is not None:
            self._claims[name] = slot_owner
        self._has_spares = any(claimed != vehicle for vehicle, claimed in self._claims.items())

    def replaced(self, own_slot_owner: str, now_ns: int) -> frozenset[str]:
        """Return the other vehicles whose slot our own vehicle or a neighbour has.

        A spare whose agent has died claims its slot for ever, also after another spare, or the
        slot's repaired owner, has got it.

        Args:
            own_slot_owner: owner of the slot that our own vehicle has; usually itself.
            now_ns: present time.
        """
        if not self._has_spares and own_slot_owner == self._own_name:
            return frozenset()

        claims = {**self._claims, self._own_name: own_slot_owner}
        holders = {self._holder(slot_owner, claims, now_ns) for slot_owner in claims.values()}
        replaced = {*claims, *claims.values()} - holders
        return frozenset(replaced - {self._own_name})

    def _holder(self, slot_owner: str, claims: dict[str, str], now_ns: int) -> str:
        """Return the vehicle that has a slot: the newest spare, if there is one.

        The slot's owner, once it is in service again, has it when the spare is gone.

        Args:
            slot_owner: owner of the slot.
            claims: vehicle in service -> owner of the slot that it claims, the newest claim last.
            now_ns: present time.
        """
        spares = []
        for name, claimed in claims.items():
            is_spare = name != slot_owner
            if is_spare and claimed == slot_owner:
                spares.append(name)
        if not spares:
            return slot_owner

        newest = spares[-1]
        is_owner_back = claims.get(slot_owner) == slot_owner
        is_newest_gone = newest != self._own_name and self._is_gone(newest, now_ns)
        if is_owner_back and is_newest_gone:
            return slot_owner
        return newest
