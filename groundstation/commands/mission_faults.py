"""Checks the faults of a flight before it begins: those of the command line, and of the mission.

The emulator knows the faults. It is imported only for a flight that has some.
"""

from __future__ import annotations

from collections.abc import Sequence

from groundstation.mission_files.mission import Mission
from groundstation.mission_files.steps import FaultStep
from onboard.config.fleet import ConfigError, FleetConfig


def refuse_wrong_faults(lines: Sequence[str], fleet: FleetConfig) -> None:
    """Refuse impossible faults of the command line.

    Args:
        lines: faults as written, ``VEHICLE NAME [at=S] [duration=S] [parameter=value ...]``.
        fleet: fleet that flies.

    Raises:
        ConfigError: a fault is unknown, or wrong; the message names it.
    """
    if not lines:
        return

    from sitl.faults.catalogue import FaultError, FaultPlan, parse
    from sitl.fleet_faults import refuse_absent_source

    plan = FaultPlan(fleet.enabled_names)
    for line in lines:
        try:
            refuse_absent_source(plan.add(parse(line), 0.0), fleet)
        except FaultError as error:
            raise ConfigError(f"The fault '{line}': {error}") from None


def refuse_wrong_fault_steps(mission: Mission) -> None:
    """Refuse impossible faults of a mission's steps.

    Args:
        mission: mission, loaded and checked.

    Raises:
        ConfigError: a fault is unknown, or wrong; the message names its step.
    """
    for course_step in mission.course():
        if isinstance(course_step.step, FaultStep):
            _refuse_wrong_fault_step(course_step.key, course_step.step, mission)


def _refuse_wrong_fault_step(key: str, step: FaultStep, mission: Mission) -> None:
    """Refuse one step whose fault the emulator would refuse in flight."""
    from sitl.faults.catalogue import Fault, FaultError, check
    from sitl.fleet_faults import refuse_absent_source

    for vehicle in mission.fleet.select(step.vehicles):
        fault = Fault(
            name=step.name,
            vehicle=vehicle,
            duration_s=step.duration_s,
            parameters=dict(step.parameters),
        )
        try:
            checked = check(fault, mission.fleet.enabled_names)
            refuse_absent_source(checked, mission.fleet)
        except FaultError as error:
            raise ConfigError(
                f"{mission.path}: '{key}': {error} covey sitl --faults lists all."
            ) from None
