"""The map of the law: the results of simulated flights, and what they imply for a fleet. Pure.

A cell of the map is a number of vehicles, a top speed, a delay and a loss of the radio, and an
accuracy of the positions. A cell is promised if all of its flights, 500 or more, kept the safety
distance. Then every easier fleet is also promised to keep it. A cell has failed if a single flight
did not keep it. Then every harder fleet is refused.

``covey simulate --map`` flies the map, and docs/law-map.md shows it. ``law_map.toml`` beside this
file is its summary.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config.fleet import ConfigError, FleetConfig
from onboard.config.toml_reading import package_table
from onboard.estimation.accuracies import Accuracy
from onboard.feasibility.finding import Finding, Status
from onboard.feasibility.pair_checks import effective_margin_m

SCHEMA = 1
PROMISED_FLIGHTS = 500  # least number of flights of a promised cell

_NAME = "map of the law"  # name of the finding
_CLASSES = ("mocap", "vision", "gps")  # accuracy classes, the least accurate last
_ROUNDING = 1e-9  # speeds, delays or losses that differ by less are equal
_MARGIN_ROUNDING_M = 1e-3  # margins that differ by less are equal
_DOCS = "docs/law-map.md shows the map."

# Values of the law that may differ from those of the map: they do not change how Covey's law
# avoids, the comparison of margins covers them, or other findings check them.
_FREE = (
    "name",
    "folder",
    "allow_own_law_on_real_vehicles",
    "design_margin_m",
    "range_m",
    "obstacle_margin_m",
    "fence_margin_m",
    "uncooperative_margin_m",
)


class MapCell(NamedTuple):
    """One cell of the map, and the results of its flights."""

    errors: str  # accuracy class of the vehicles' positions
    vehicles: int
    speed_m_s: float  # top speed
    delay_s: float
    loss_frac: float
    margin_m: float  # in flight
    flights: int
    below: int  # number of flights in which two vehicles came too near
    arrived: int  # number of flights in which all vehicles arrived
    worst_m: float  # smallest distance of all flights

    @property
    def has_failed(self) -> bool:
        """Whether two vehicles came too near in some flight."""
        return self.below > 0

    @property
    def is_promised(self) -> bool:
        """Whether there are enough flights, and vehicles never came too near."""
        return self.flights >= PROMISED_FLIGHTS and not self.below

    def is_within(self, other: MapCell) -> bool:
        """Whether this cell is not harder than another one in any axis.

        Args:
            other: the other cell.
        """
        return (
            _CLASSES.index(self.errors) <= _CLASSES.index(other.errors)
            and self.vehicles <= other.vehicles
            and self.speed_m_s <= other.speed_m_s + _ROUNDING
            and self.delay_s <= other.delay_s + _ROUNDING
            and self.loss_frac <= other.loss_frac + _ROUNDING
        )

    def __str__(self) -> str:
        """Return the cell in words."""
        return (
            f"{self.vehicles} vehicles at up to {self.speed_m_s:g} m/s, states "
            f"{1e3 * self.delay_s:g} ms late and {100.0 * self.loss_frac:g} % lost, "
            f"'{self.errors}'"
        )


class LawMap(NamedTuple):
    """The cells that have been flown, and the vehicles and the law that flew them."""

    version: str  # version of the law
    safety_distance_m: float
    lag_s: float  # lag of the vehicles
    law: Mapping[str, Mapping[str, object]]  # accuracy class -> values of ``[law]``
    cells: tuple[MapCell, ...]


def law_map_of(table: Mapping[str, Any]) -> LawMap:
    """Return the map that a table describes.

    Args:
        table: tables of ``law_map.toml``.
    Raises:
        ConfigError: The tables have a different schema version.
    """
    if table.get("schema") != SCHEMA:
        raise ConfigError(
            f"The map of the law has schema {table.get('schema')}, but this version of Covey reads "
            f"{SCHEMA}. Install Covey anew."
        )

    flown = table["flown"]
    return LawMap(
        version=table["version"],
        safety_distance_m=flown["safety_distance_m"],
        lag_s=flown["lag_s"],
        law=table["law"],
        cells=tuple(MapCell(*row) for row in table["cells"]),
    )


def shipped() -> LawMap:
    """Return the map that is part of this software."""
    return law_map_of(package_table("onboard.feasibility", "law_map.toml"))


def map_finding(fleet: FleetConfig, accuracy: Accuracy, law_map: LawMap) -> Finding:
    """Return the finding about a fleet from the map.

    Args:
        fleet: the fleet file, with two vehicles or more and the law 'covey'.
        accuracy: accuracy of the vehicles' estimates.
        law_map: the map.
    Returns:
        A refusal if an easier or equal cell has failed. Otherwise ok if a harder or equal cell is
        promised with the same distances and law, and no wider margin. Otherwise a warning if harder
        cells are promised only with a wider margin. Otherwise a note.
    """
    here = _cell_of(fleet, accuracy)
    promised = [cell for cell in law_map.cells if cell.is_promised]

    # a failed easier cell decides, even if harder cells are promised
    easier = [cell for cell in law_map.cells if cell.is_within(here)]
    failed = [cell for cell in easier if cell.has_failed]
    if failed:
        return _refusal(here, failed, promised, law_map)

    harder = [cell for cell in promised if here.is_within(cell)]
    covering = [cell for cell in harder if cell.margin_m <= here.margin_m + _MARGIN_ROUNDING_M]
    differences = _differences(fleet, accuracy, law_map)
    if covering and not differences:
        return _promise(here, covering, law_map)

    if harder:
        remedy = _remedy(here, harder)
    else:
        remedy = _remedy(here, promised)

    if covering:
        return _uncovered(here, "note", f"the map was flown with {differences}", remedy)
    if harder:
        least_m = min(cell.margin_m for cell in harder)
        reason = (
            f"the map was flown with a margin of {least_m:.2f} m there, here it is "
            f"{here.margin_m:.2f} m"
        )
        return _uncovered(here, "warning", reason, remedy)
    return _uncovered(here, "note", "nothing that hard was flown often enough", remedy)


def _cell_of(fleet: FleetConfig, accuracy: Accuracy) -> MapCell:
    """Return the cell that describes a fleet; its results are empty."""
    vehicles = [fleet.vehicles[name] for name in fleet.enabled_names]
    return MapCell(
        errors=accuracy.name,
        vehicles=len(vehicles),
        speed_m_s=max(vehicle.max_speed_m_s for vehicle in vehicles),
        delay_s=fleet.expected_radio.expected_delay_s,
        loss_frac=fleet.expected_radio.expected_loss_frac,
        margin_m=effective_margin_m(fleet, accuracy),
        flights=0,
        below=0,
        arrived=0,
        worst_m=0.0,
    )


def _refusal(
    here: MapCell, failed: Sequence[MapCell], promised: Sequence[MapCell], law_map: LawMap
) -> Finding:
    """Return the refusal for the cell with the largest share of failed flights."""
    worst = max(failed, key=lambda cell: cell.below / cell.flights)
    remedy = _remedy(here, promised)
    sentence = (
        f"The fleet is {here}. In simulation {worst.below} of {worst.flights} flights of an easier "
        f"or equal cell came below {law_map.safety_distance_m:.2f} m ({worst}, worst "
        f"{worst.worst_m:.2f} m). {remedy}"
    )
    return Finding(
        name=_NAME,
        status="refused",
        value=worst.below,
        bound=0.0,
        unit="flights",
        relation="at most",
        sentence=sentence,
        remedy=remedy,
    )


def _promise(here: MapCell, covering: Sequence[MapCell], law_map: LawMap) -> Finding:
    """Return the finding that the nearest covering cell promises."""
    cell = min(covering, key=lambda cell: _distance(here, cell))
    sentence = (
        f"The fleet is {here}. In simulation 0 of {cell.flights} flights came below "
        f"{law_map.safety_distance_m:.2f} m with {cell} (worst {cell.worst_m:.2f} m)."
    )
    return Finding(
        name=_NAME,
        status="ok",
        value=0.0,
        bound=0.0,
        unit="flights",
        relation="at most",
        sentence=sentence,
        remedy="Nothing to do.",
    )


def _uncovered(here: MapCell, status: Status, reason: str, remedy: str) -> Finding:
    """Return the finding that no cell covers the fleet, and why."""
    sentence = (
        f"The fleet is {here}: no cell of the map of the law promises that; {reason}. {remedy}"
    )
    return Finding(
        name=_NAME,
        status=status,
        value=0.0,
        bound=PROMISED_FLIGHTS,
        unit="flights",
        relation="at least",
        sentence=sentence,
        remedy=remedy,
    )


def _remedy(here: MapCell, cells: Sequence[MapCell]) -> str:
    """Return a remedy that names the nearest of some promised cells."""
    nearest = min(cells, key=lambda cell: _distance(here, cell), default=None)
    if nearest is None:
        return f"No cell of the map holds. {_DOCS}"
    return f"Nearest cell that holds: {nearest}. {_DOCS}"


def _distance(here: MapCell, cell: MapCell) -> float:
    """Return the distance between two cells. A class counts 10, a step on another axis about 1."""
    classes = _CLASSES.index(here.errors) - _CLASSES.index(cell.errors)
    return (
        10.0 * abs(classes)
        + abs(here.vehicles - cell.vehicles) / 5.0
        + abs(here.speed_m_s - cell.speed_m_s)
        + abs(here.delay_s - cell.delay_s) / 0.05
        + abs(here.loss_frac - cell.loss_frac) / 0.1
    )


def _differences(fleet: FleetConfig, accuracy: Accuracy, law_map: LawMap) -> str:
    """Return in words how the fleet differs from the map's fleets, law and vehicles; empty if it
    does not.
    """
    different = []

    safety_distance_m = fleet.fleet.safety_distance_m
    if safety_distance_m != law_map.safety_distance_m:
        different.append(
            f"fleet.safety_distance_m = {law_map.safety_distance_m} (here {safety_distance_m})"
        )

    vertical_separation_m = fleet.fleet.vertical_separation_m
    if vertical_separation_m is not None:
        different.append(f"no fleet.vertical_separation_m (here {vertical_separation_m})")

    flown = law_map.law.get(accuracy.name, {})
    for key, flown_value in flown.items():
        own_value = getattr(fleet.law, key)
        if own_value != flown_value:
            different.append(f"law.{key} = {flown_value} (here {own_value})")

    lag_s = max(fleet.vehicles[name].lag_s for name in fleet.enabled_names)
    if lag_s > law_map.lag_s + LAG_ERROR_S:
        different.append(
            f"vehicles that follow a command {law_map.lag_s:.2f} s later (here {lag_s:.2f} s)"
        )

    return ", ".join(different)


def values_of(fleet: FleetConfig) -> dict[str, object]:
    """Return the values of a fleet's ``[law]`` that are compared with the map's.

    Args:
        fleet: a fleet that flew the map.
    """
    law = fleet.law
    return {key: getattr(law, key) for key in _compared(law.__struct_fields__)}


def _compared(keys: Iterable[str]) -> list[str]:
    """Return the keys of ``[law]`` whose values must equal those of the map."""
    return [key for key in keys if key not in _FREE and not key.startswith("paper_")]
