"""Cells of the map: what is flown in each, in which stages, and with which values."""

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
ERRORS = {"mocap": (3, 8, 16), "vision": (8,)}  # numbers of vehicles that are flown with each class
FIRST_SEED = 1000
# seeds of each scenario in a stage: a screening of every cell first, 504 flights after the last
STAGES = (range(1000, 1007), range(1007, 1034), range(1034, 1101), range(1101, 1168))
_SCENARIO_FORMATS = ("swap{}x", "swap{}", "rand{}")
# a vehicle that avoids nobody flies so long with this share of its top speed or more
_HELD_S = 2.0
_HELD_SHARE = 0.9
_CIRCLE_SPACING_M = 1.25  # of neighbours on the circle of a swap
_TILTS_DEG = (30, 35, 40, 45)


@dataclass(frozen=True, slots=True, order=True)
class Cell:
    """One place of the map."""

    errors: str
    vehicles: int
    speed_m_s: float
    delay_ms: float
    loss_pct: float

    @property
    def key(self) -> str:
        """Name in the file of results."""
        radio = f"{self.delay_ms:g} ms {self.loss_pct:g} %"
        return f"{self.errors} {self.vehicles} vehicles {self.speed_m_s:g} m/s {radio}"

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios that are flown."""
        return tuple(text.format(self.vehicles) for text in _SCENARIO_FORMATS)

    @property
    def weight(self) -> float:
        """Processor time of a flight, relative to others; the time left is estimated by it."""
        return 1.0 + 0.02 * math.pow(self.vehicles, 1.7)


@dataclass(frozen=True, slots=True)
class Unit:
    """One stage of one cell: the smallest piece that is flown and kept."""

    cell: Cell
    stage: int

    @property
    def flights(self) -> int:
        """Number of flights."""
        return len(STAGES[self.stage]) * len(_SCENARIO_FORMATS)


def cells(selection: Sequence[str] = ()) -> list[Cell]:
    """Return the cells of the map, the easy ones first.

    Args:
        selection: ``axis=value,value`` each, for instance ``vehicles=3,8`` or ``errors=vision``;
            all by default.
    Raises:
        ConfigError: an unknown axis or value.
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
        places = product(counts, kept["speed_m_s"], kept["delay_ms"], kept["loss_pct"])
        for vehicles, speed_m_s, delay_ms, loss_pct in places:
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
    """Return the steps from the easiest cell, and the cell itself, so that no two are equal."""
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
    """Return what a cell sets, as words of ``--set``; all else is as by default.

    The margin, the range and the tilt are those that ``covey check`` demands at that speed, delay
    and loss.
    """
    accuracy = ACCURACIES[cell.errors]
    fleet, given = _with_least_tilt(cell)
    vehicle = next(iter(fleet.vehicles.values()))
    law = fleet.law

    margin_m = max(law.design_margin_m, margin_for_age_m(fleet, accuracy))
    flown_margin_m = max(margin_m, effective_margin_m(fleet, accuracy))
    distance_m = fleet.fleet.safety_distance_m + flown_margin_m

    closing_m_s = 2.0 * law.avoid_speed_frac * cell.speed_m_s
    row_range_m = bounds.row_range_m(closing_m_s, distance_m, law.kappa_1_1_s, law.kappa_2_1_s)
    late_m = closing_m_s * (message_age_s(fleet) + vehicle.lag_s)
    range_m = _rounded_up(max(law.range_m, row_range_m + late_m), 0.5)

    return (*given, f"law.design_margin_m={margin_m:g}", f"law.range_m={range_m:g}")


def _with_least_tilt(cell: Cell) -> tuple[FleetConfig, tuple[str, ...]]:
    """Return the fleet of a cell and what it sets, with the smallest tilt that its braking allows.

    Where the braking allows none of the tilts, it is the largest.
    """
    for tilt_deg in _TILTS_DEG:
        given = (*_set_by_axes(cell), f"vehicle.max_tilt_deg={tilt_deg}")
        fleet = campaign_settings.setup_for(errors=cell.errors, changes=given).fleet(cell.vehicles)
        vehicle = next(iter(fleet.vehicles.values()))
        margin_m = effective_margin_m(fleet, ACCURACIES[cell.errors])
        if braking(fleet, vehicle, margin_m).status != "refused":
            break
    return fleet, given


def _set_by_axes(cell: Cell) -> tuple[str, ...]:
    return (
        f"delay_s={1e-3 * cell.delay_ms:g}",
        f"loss_share={1e-2 * cell.loss_pct:g}",
        f"vehicle.max_speed_m_s={cell.speed_m_s:g}",
    )


def _rounded_up(value: float, step: float) -> float:
    return round(math.ceil(value / step - 1e-9) * step, 6)


def setup(cell: Cell, scenario: str) -> campaign_settings.Setup:
    """Return the setup of a scenario in a cell.

    Its lengths are scaled so that the top speed is held, and that all vehicles can park.
    """
    plain = campaign_settings.setup_for(errors=cell.errors, changes=changes(cell))
    fleet = plain.fleet(cell.vehicles)

    if scenario.startswith("swap"):
        circumference_m = max(5.0 * math.pi, _CIRCLE_SPACING_M * cell.vehicles)
        longest_m = circumference_m / math.pi
        spacing_m = circumference_m / cell.vehicles
    else:
        longest_m = math.sqrt(6.0 * cell.vehicles)
        spacing_m = 1.4

    required_m = parking_m(fleet, ACCURACIES[cell.errors]) + 0.15  # the starts are jittered
    scale_for_speed = _held_distance_m(cell.speed_m_s) / longest_m
    scale_for_parking = required_m / spacing_m
    scale = max(1.0, scale_for_speed, scale_for_parking)
    return replace(plain, scale=round(scale, 3))


def _held_distance_m(speed_m_s: float) -> float:
    """Return the length of a leg that holds a share of the top speed for :data:`_HELD_S`.

    A leg is a quintic: its speed is 16 s^2 (1 - s)^2 of the peak 15/8 D/T after the share s of the
    time.
    """
    half = math.sqrt(0.25 - math.sqrt(_HELD_SHARE) / 4.0)  # of the share that is flown fast
    return 8.0 / 15.0 * speed_m_s * _HELD_S / (2.0 * half)


def commands(cell: Cell) -> list[str]:
    """Return the commands that fly the cell's flights alone."""
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
