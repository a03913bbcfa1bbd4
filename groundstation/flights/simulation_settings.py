"""The settings of a simulated flight, besides its fleet and its mission.

Seed, weather, faults and orders of others come from the command line. They are written into the
flight folder, so that the folder contains all that is needed to fly the flight again.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import NamedTuple

import msgspec

from groundstation.orders.grammar import OrderError, parse
from groundstation.recording.writer import write_json
from onboard.config.file_reading import SIMULATION_FILE, json_values, read_text
from onboard.config.fleet import ConfigError, FleetConfig

SIMULATION_NAME = "simulation.json"
LARGEST_WIND_M_S = 30.0  # per axis

_LATEST_ORDER_S = 1e6


class SimulationSettings(msgspec.Struct, frozen=True, kw_only=True):
    """All settings in which two simulated flights of the same files can differ."""

    is_lockstep: bool = False  # whether it is flown in simulated time, and so is repeatable
    seed: int = 0  # seed of all random numbers
    wind_enu_m_s: tuple[float, float] = (0.0, 0.0)  # mean velocity of the air, east and north
    gust_m_s: float = 0.0  # standard deviation of gusts per axis
    faults: tuple[str, ...] = ()  # lines as `covey sitl --fault` takes them
    orders: tuple[str, ...] = ()  # orders of another ground, "SECONDS ORDER"; in lockstep only
    bus: dict[str, float] = {}  # settings of the simulated bus by name; in lockstep only
    changes: tuple[str, ...] = ()  # changes in flight, "SECONDS KEY=VALUE"; see changes.py
    mission_path: str = ""  # path of the mission file, to which files that it names are relative
    arguments: dict[str, str] = {}  # arguments of a Python mission


class TimedOrder(NamedTuple):
    """An order that another ground gives at a time."""

    at_s: float  # simulated time
    text: str  # the order as in the console


def wind_of(text: str, *, option: str = "--wind-m-s") -> tuple[float, float]:
    """Return a wind that is written as EAST,NORTH [m/s].

    Args:
        text: the written wind.
        option: where it was written, for the message.

    Raises:
        ConfigError: the text has another form, or the wind is too strong for the emulator.
    """
    try:
        east, north = (float(part) for part in text.split(","))
    except ValueError:
        east = north = math.nan
    is_allowed = abs(east) <= LARGEST_WIND_M_S and abs(north) <= LARGEST_WIND_M_S  # False for NaN
    if not is_allowed:
        raise ConfigError(
            f"{option} is '{text}'; write it as EAST,NORTH, each at most {LARGEST_WIND_M_S:g} m/s."
        )
    return (east, north)


def timed_order(line: str) -> TimedOrder:
    """Return the order of a line ``SECONDS ORDER``.

    Raises:
        ConfigError: the line does not begin with a time, or has no order.
    """
    time_word, _, text = line.strip().partition(" ")
    try:
        at_s = float(time_word)
    except ValueError:
        at_s = math.nan
    is_time = 0.0 <= at_s <= _LATEST_ORDER_S  # False for NaN
    if not is_time or not text.strip():
        raise ConfigError(
            f"--order is '{line}'; write the second of simulated time and the order,"
            " for instance '12.5 hold all'."
        )
    return TimedOrder(at_s=at_s, text=text.strip())


def order_for(fleet: FleetConfig, line: str) -> TimedOrder:
    """Return the order of a line ``SECONDS ORDER``, which this fleet understands.

    Raises:
        ConfigError: the line has another form, or its order is none for this fleet.
    """
    order = timed_order(line)
    try:
        parse(order.text, fleet)
    except OrderError as error:
        raise ConfigError(f"The order '{line}': {error}") from None
    return order


def refuse_wrong_settings(settings: SimulationSettings) -> None:
    """Refuse a negative seed, gusts out of bounds, and orders without a time.

    Raises:
        ConfigError: there is one of them.
    """
    if settings.seed < 0:
        raise ConfigError(f"The seed is {settings.seed}; it must be 0 or more.")
    if not 0.0 <= settings.gust_m_s <= LARGEST_WIND_M_S:
        raise ConfigError(
            f"Gusts of {settings.gust_m_s:g} m/s cannot be simulated; they must lie between 0 and"
            f" {LARGEST_WIND_M_S:g} m/s."
        )
    for line in settings.orders:
        timed_order(line)


def emulator_options(settings: SimulationSettings) -> list[str]:
    """Return the options of ``covey sitl`` for the weather and the faults."""
    words: list[str] = []
    east_m_s, north_m_s = settings.wind_enu_m_s
    if east_m_s or north_m_s:
        words.append(f"--wind-m-s={east_m_s:g},{north_m_s:g}")
    if settings.gust_m_s:
        words.append(f"--gust-m-s={settings.gust_m_s:g}")
    for line in settings.faults:
        words.extend(["--fault", line])
    return words


def write_settings(folder: Path, settings: SimulationSettings) -> None:
    """Write the settings into the folder of a flight.

    Raises:
        ConfigError: the file cannot be written.
    """
    failure = write_json(folder / SIMULATION_NAME, settings)
    if failure is not None:
        raise ConfigError(failure)


def read_settings(folder: str | os.PathLike[str]) -> SimulationSettings:
    """Return the settings of a simulated flight from its folder.

    Raises:
        ConfigError: the folder contains none, or they are wrong.
    """
    path = Path(folder) / SIMULATION_NAME
    if not path.is_file():
        raise ConfigError(
            f"{folder}: there is no {SIMULATION_NAME}, so nobody knows how this flight was"
            " simulated. It is a real flight, or one of an older version."
        )
    values = json_values(read_text(path, SIMULATION_FILE), str(path))
    try:
        settings = msgspec.convert(values, SimulationSettings)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{path}: {error}. Fly the mission anew.") from None
    refuse_wrong_settings(settings)
    return settings
