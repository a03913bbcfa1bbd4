"""Collects the reported positions of standing vehicles for some time.

``covey import spots`` makes take-off spots of them.
"""

from __future__ import annotations

from collections.abc import Sequence

from groundstation.client.client import FleetClient
from groundstation.fleet.state import FleetState
from onboard.bus.schema import Telemetry
from onboard.config.fleet import ConfigError
from onboard.safety.failsafe_table import Condition
from onboard.tuples import Xyz

CONNECT_S = 3.0  # longest wait until the vehicles are heard
# conditions under which a vehicle's position is not good enough
_POOR = (
    Condition.POSITION_STALE,
    Condition.POSITION_LOST,
    Condition.POSITION_INACCURATE,
    Condition.POSITION_UNFIT,
    Condition.SATELLITES_LOST,
)


async def standing_positions(
    client: FleetClient, names: Sequence[str], duration_s: float
) -> dict[str, list[Xyz]]:
    """Connect, collect positions of vehicles that stand, and disconnect.

    Args:
        client: fleet client that has not been started.
        names: names of the vehicles.
        duration_s: time for which positions are collected [s].

    Returns:
        name -> positions [m], ENU, one for each telemetry message.

    Raises:
        ConfigError: a vehicle is not heard, flies or is armed, or does not know its position well.
    """
    positions: dict[str, list[Xyz]] = {name: [] for name in names}
    last_sequence: dict[str, int] = {}  # vehicle -> sequence number of its newest telemetry
    refusals: list[str] = []

    def look(state: FleetState) -> None:
        for name in names:
            telemetry = state.vehicles[name].telemetry
            if telemetry is None or last_sequence.get(name) == telemetry.sequence:
                continue
            last_sequence[name] = telemetry.sequence

            refusal = _refusal(telemetry)
            if refusal:
                refusals.append(refusal)
            else:
                positions[name].append(telemetry.position_enu_m)

    await client.start()
    try:
        await client.wait_for(lambda state: _are_heard(state, names), CONNECT_S)
        silent = [name for name in names if client.state.vehicles[name].telemetry is None]
        if silent:
            raise ConfigError(
                f"Not heard: {', '.join(silent)}. Start their agents, or name the others with "
                "--vehicles."
            )
        client.add_listener(look)
        # The wait lasts the whole time, unless a position is refused.
        await client.wait_for(lambda _: bool(refusals), duration_s)
    finally:
        await client.stop()

    if refusals:
        raise ConfigError(refusals[0])
    return positions


def _are_heard(state: FleetState, names: Sequence[str]) -> bool:
    return all(state.vehicles[name].telemetry is not None for name in names)


def _refusal(telemetry: Telemetry) -> str:
    """Return why a vehicle's position cannot be used as a spot; empty if it can."""
    name = telemetry.vehicle
    rule = "spots are surveyed while all stand disarmed. Land it first."
    if telemetry.is_airborne:
        return f"{name} flies: {rule}"
    if telemetry.is_armed:
        return f"{name} is armed: {rule}"

    poor = [condition.value for condition in _POOR if condition.value in telemetry.conditions]
    if poor or not telemetry.is_position_valid:
        reason = ", ".join(poor) or "it has no valid position"
        return f"{name} does not know well where it is: {reason}. See covey check vehicles."
    return ""
