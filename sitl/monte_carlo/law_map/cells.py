"""The cells of the map of the law: their axes, their scenarios and seeds, and their settings.

A cell is flown in stages of more and more seeds. Each setting that an axis does not fix is what
``covey check`` demands for that cell.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

from onboard.config.fleet import ConfigError, FleetConfig
from onboard.estimation.accuracies import ACCURACIES
from onboard.feasibility import bounds
from onboard.feasibility.pair_checks import (
    braking,
    effective_margin_m,
    margin_for_age_m,
    message_age_s,
    parking_m,
)
from sitl.monte_carlo import campaign_settings

AXES: dict[str, tuple[float, ...]] = {
    "vehicles": (3, 8, 16),
    "speed_m_s": (1.0, 2.0, 4.0),
    "delay_ms": (20.0, 50.0, 100.0, 200.0, 300.0),
    "loss_pct": (0.0, 10.0, 30.0),
}
ERRORS = {"mocap": (3, 8, 16), "vision": (8,)}  # error class -> numbers of vehicles
FIRST_SEED = 1000
# seeds of each scenario in a stage; the first stage is a screening, and all stages together are 504
# flights
STAGES = (range(1000, 1007), range(1007, 1034), range(1034, 1101), range(1101, 1168))
_SCENARIO_FORMATS = ("swap{}x", "swap{}", "rand{}")  # completed by the number of vehicles
# Scenarios are scaled so that, without avoidance, a vehicle flies for _HELD_S at _HELD_SHARE of its
# top speed or faster.
_HELD_S = 2.0
_HELD_SHARE = 0.9
_CIRCLE_SPACING_M = 1.25  # distance of neighbours on the circle of a swap
_TILTS_DEG = (30, 35, 40, 45)


@dataclass(frozen=True, slots=True, order=True)
class Cell:
    """One cell of the map: one value on each axis."""

    errors: str
    vehicles: int
    speed_m_s: float
    delay_ms: float
    loss_pct: float

    @property
    def key(self) -> str:
        """The cell's name in the file of results."""
        radio = f"{self.delay_ms:g} ms {self.loss_pct:g} %"
        return f"{self.errors} {self.vehicles} vehicles {self.speed_m_s:g} m/s {radio}"

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios that are flown."""
        return tuple(text.format(self.vehicles) for text in _SCENARIO_FORMATS)

    @property
    def weight(self) -> float:
        """Processor time of a flight relative to that in other cells, to estimate the time left."""
        return 1.0 + 0.02 * math.pow(self.vehicles, 1.7)


@dataclass(frozen=True, slots=True)
class Unit:
    """One stage of one cell: the smallest piece of work whose results are kept."""

    cell: Cell
    stage: int

    @property
    def flights(self) -> int:
        """Number of flights."""
        return len(STAGES[self.stage]) * len(_SCENARIO_FORMATS)


def cells(selection: Sequence[str] = ()) -> list[Cell]:
    """Return the cells of the map, the easiest ones first.

    Args:
        selection: ``axis=value,value`` for each restricted axis, for instance ``vehicles=3,8`` or
            ``errors=vision``; by default all cells.

    Raises:
        ConfigError: an axis or a value is unknown.
    """
    kept: dict[str, set[float]] = {axis: set(values) for axis, values in AXES.items()}
    errors = set(ERRORS)
    for words in selection:
        axis, _, text = words.partition("=")
        if axis == "errors":
            errors = _selected(words, text.split(","), ERRORS)
        elif axis in AXES:
            by_text = {f"{value:g}": value for value in AXES[axis]}
            kept[axis] = {by_text[value] for value in _selected(words, text.split(","), by_text)}
        else:
            raise ConfigError(
                f"--cells {words}: write AXIS=VALUE,VALUE. Axes: {', '.join(AXES)}; "
                f"errors of {', '.join(ERRORS)}."
            )

    selected = []
    for name, counts in ERRORS.items():
        if name not in errors:
            continue
        combinations = product(counts, kept["speed_m_s"], kept["delay_ms"], kept["loss_pct"])
        for vehicles, speed_m_s, delay_ms, loss_pct in combinations:
            if vehicles in kept["vehicles"]:
                selected.append(
                    Cell(
                        errors=name,
                        vehicles=vehicles,
                        speed_m_s=speed_m_s,
                        delay_ms=delay_ms,
                        loss_pct=loss_pct,
                    )
                )
    if not selected:
        raise ConfigError(
            f"--cells {' '.join(selection)}: the map has no such cell; vision is flown with 8 "
            "vehicles."
        )
    return sorted(selected, key=_hardness)


def _hardness(cell: Cell) -> tuple[int, Cell]:
    """Return a sort key: the number of steps from the easiest cell, and then the cell itself."""
    values = (cell.vehicles, cell.speed_m_s, cell.delay_ms, cell.loss_pct)
    steps = sum(axis.index(value) for axis, value in zip(AXES.values(), values, strict=True))
    if cell.errors == "vision":
        steps += 1
    return steps, cell


def _selected(words: str, texts: Collection[str], known: Collection[str]) -> set[str]:
    unknown = [text for text in texts if text not in known]
    if unknown:
        raise ConfigError(
            f"--cells {words}: '{unknown[0]}' is not on the map; there are {', '.join(known)}."
        )
    return set(texts)


@cache
def changes(cell: Cell) -> tuple[str, ...]:
    """Return the settings of a cell as arguments of ``--set``; all others keep their defaults.

    Margin, range and tilt are those that ``covey check`` demands at the cell's speed, delay and
    loss.
    """
    accuracy = ACCURACIES[cell.errors]
    fleet, settings = _with_least_tilt(cell)
    vehicle = next(iter(fleet.vehicles.values()))
    law = fleet.law

    # distance from which the law has to keep the vehicles
    margin_m = max(law.design_margin_m, margin_for_age_m(fleet, accuracy))
    flown_margin_m = max(margin_m, effective_margin_m(fleet, accuracy))
    distance_m = fleet.fleet.safety_distance_m + flown_margin_m

    # range at which avoidance of a neighbour begins: two vehicles that close head-on can then still
    # brake despite old messages and the lag of the attitude
    closing_m_s = 2.0 * law.avoid_speed_frac * cell.speed_m_s
    row_range_m = bounds.row_range_m(closing_m_s, distance_m, law.kappa_1_1_s, law.kappa_2_1_s)
    late_m = closing_m_s * (message_age_s(fleet) + vehicle.lag_s)
    range_m = _rounded_up(max(law.range_m, row_range_m + late_m), 0.5)

    return (*settings, f"law.design_margin_m={margin_m:g}", f"law.range_m={range_m:g}")


def _with_least_tilt(cell: Cell) -> tuple[FleetConfig, tuple[str, ...]]:
    """Return the fleet of a cell and its settings, with the smallest tilt that brakes in time.

    If no tilt is enough, the largest is taken.
    """
    for tilt_deg in _TILTS_DEG:
        settings = (*_set_by_axes(cell), f"vehicle.max_tilt_deg={tilt_deg}")
        setup = campaign_settings.setup_for(errors=cell.errors, changes=settings)
        fleet = setup.fleet(cell.vehicles)
        vehicle = next(iter(fleet.vehicles.values()))
        margin_m = effective_margin_m(fleet, ACCURACIES[cell.errors])
        if braking(fleet, vehicle, margin_m).status != "refused":
            break
    return fleet, settings


def _set_by_axes(cell: Cell) -> tuple[str, ...]:
    """Return the settings that the axes fix, as arguments of ``--set``."""
    return (
        f"delay_s={1e-3 * cell.delay_ms:g}",
        f"loss_share={1e-2 * cell.loss_pct:g}",
        f"vehicle.max_speed_m_s={cell.speed_m_s:g}",
    )


def _rounded_up(value: float, step: float) -> float:
    # 1e-9 keeps a rounding error from adding a step
    return round(math.ceil(value / step - 1e-9) * step, 6)


def setup(cell: Cell, scenario: str) -> campaign_settings.Setup:
    """Return the setup of a scenario in a cell.

    The scenario is scaled so that vehicles fly at top speed for a while, and that all of them can
    hover at their goals at the same time.
    """
    unscaled = campaign_settings.setup_for(errors=cell.errors, changes=changes(cell))
    fleet = unscaled.fleet(cell.vehicles)

    if scenario.startswith("swap"):
        # the circle of "swap", whose vehicles fly across it (scenarios.py)
        circumference_m = max(5.0 * math.pi, _CIRCLE_SPACING_M * cell.vehicles)
        longest_m = circumference_m / math.pi
        spacing_m = circumference_m / cell.vehicles
    else:
        # side of the room and spacing of the goals of "rand" (scenarios.py)
        longest_m = math.sqrt(6.0 * cell.vehicles)
        spacing_m = 1.4

    # distance at which vehicles can hover beside each other, and more for the jitter of the starts
    required_m = parking_m(fleet, ACCURACIES[cell.errors]) + 0.15
    scale_for_speed = _held_distance_m(cell.speed_m_s) / longest_m
    scale_for_parking = required_m / spacing_m
    scale = max(1.0, scale_for_speed, scale_for_parking)
    return replace(unscaled, scale=round(scale, 3))


def _held_distance_m(speed_m_s: float) -> float:
    """Return the length D of a leg that is flown near top speed for :data:`_HELD_S` seconds.

    A leg is a quintic of duration T. After the share s of its time its speed is 16 s^2 (1 - s)^2
    times its peak 15/8 D/T. The speed is at least :data:`_HELD_SHARE` of the peak while s differs
    from 1/2 by less than a half width.

    The peak is to be the top speed, and the share of T near it is to last :data:`_HELD_S`.
    """
    half_width = math.sqrt(0.25 - math.sqrt(_HELD_SHARE) / 4.0)
    duration_s = _HELD_S / (2.0 * half_width)
    return 8.0 / 15.0 * speed_m_s * duration_s


def commands(cell: Cell) -> list[str]:
    """Return the commands that fly the flights of this cell without the map."""
    end = STAGES[-1].stop
    sets = " ".join(f"--set {change}" for change in changes(cell))
    lines = []
    for name in cell.scenarios:
        scale = setup(cell, name).scale
        lines.append(
            f"covey simulate {name} --seeds {FIRST_SEED}:{end} --errors {cell.errors} "
            f"--scale {scale:g} {sets}"
        )
    return lines
