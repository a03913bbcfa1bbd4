"""Types of options that several commands share, with the texts that their help shows.

A command declares ``fleet: FleetFile`` or ``options: FlightOptions``. So name, placeholder and
sentence of the option are the same in all commands.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from onboard.config.fleet import ConfigError
from onboard.config.law import BUILT_IN

# Cyclopts reads these unions: Path and Literal give a shell its completions, and the values are
# text, because every text already fits str or the Literal.
FILE_OR_TEXT: Any = str | Path
LAW_OR_TEXT: Any = Literal[BUILT_IN] | str
if TYPE_CHECKING:
    FileName = str
    NameOfLaw = str
else:
    FileName = FILE_OR_TEXT
    NameOfLaw = LAW_OR_TEXT

File = Annotated[FileName, Parameter(metavar="FILE")]
FleetFile = Annotated[FileName, Parameter(metavar="FILE", help="fleet file")]
Folder = Annotated[Path, Parameter(metavar="DIR")]
Names = Annotated[str, Parameter(metavar="NAMES")]  # names or indices of vehicles
Seconds = Annotated[float, Parameter(metavar="S")]
# covey, paper, off, or a user's own law
LawName = Annotated[NameOfLaw | None, Parameter(metavar="NAME", show_choices=False)]

_SHORTEST_S = 0.5  # shortest run of a relay
# bounds of the time between two reports of a relay
_MIN_PERIOD_S = 0.1
_MAX_PERIOD_S = 3600.0

_WORLD = Group("The world of a simulated flight", sort_key=8)
_BUS = Parameter(group=Group("The bus of a flight in lockstep", sort_key=9), metavar="X")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class BusOptions:
    """Delays and losses of the simulated bus of a flight in lockstep.

    Args:
        bus_delay_s: shortest time from sender to receiver (default 0.001)
        bus_jitter_s: mean of the random time that is added to bus_delay_s (default 0)
        bus_loss: chance that a message is lost (default 0)
        bus_burst: mean number of messages lost in a row (default 1: each by itself)
        bus_reorder: chance that a message is overtaken (default 0)
        bus_duplicate: chance that a message comes twice (default 0)
    """

    bus_delay_s: Annotated[float | None, _BUS] = None
    bus_jitter_s: Annotated[float | None, _BUS] = None
    bus_loss: Annotated[float | None, _BUS] = None
    bus_burst: Annotated[float | None, _BUS] = None
    bus_reorder: Annotated[float | None, _BUS] = None
    bus_duplicate: Annotated[float | None, _BUS] = None

    @property
    def given(self) -> dict[str, float]:
        """Values of the given options, by the names of the simulated bus's settings."""
        values = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None:
                values[field.name.removeprefix("bus_")] = value
        return values


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class FlightOptions:
    """Options of commands that fly a mission.

    Args:
        headless: no console: progress in lines, ends by itself
        record: flight folder (default: flights/<time>)
        law: covey, paper, off or a law of your own, instead of the fleet file's (simulated flights)
        seed: seed of everything random in the emulator
        lockstep: agents and emulator in one process, in simulated time
        arg: argument of a Python mission, NAME=VALUE; may be given several times
    """

    fleet: Annotated[
        FileName | None, Parameter(metavar="FILE", help="fleet file instead of the mission's")
    ] = None
    headless: bool = False
    record: Folder | None = None
    law: LawName = None
    seed: int = 0
    lockstep: bool = False
    arg: Annotated[tuple[str, ...], Parameter(metavar="NAME=VALUE")] = ()


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class WorldOptions:
    """Weather, faults and orders of others in a simulated flight.

    Args:
        wind_m_s: mean wind: its components towards east and north
        gust_m_s: standard deviation of the gusts
        fault: a fault, for instance 'mav1 motor_dead at=20 motor=2'; may be given several times;
            covey sitl --faults lists them
        order: an order from somebody else, for instance '12.5 hold all'; with --lockstep; may be
            given several times
    """

    wind_m_s: Annotated[
        str | None, Parameter(group=_WORLD, metavar="EAST,NORTH", allow_leading_hyphen=True)
    ] = None
    gust_m_s: Annotated[float, Parameter(group=_WORLD, metavar="X", show_default=False)] = 0.0
    fault: Annotated[tuple[str, ...], Parameter(group=_WORLD, metavar="LINE")] = ()
    order: Annotated[tuple[str, ...], Parameter(group=_WORLD, metavar="'S ORDER'")] = ()

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the given options, as they are typed."""
        names = []
        if self.wind_m_s is not None:
            names.append("--wind-m-s")
        if self.gust_m_s:
            names.append("--gust-m-s")
        if self.fault:
            names.append("--fault")
        if self.order:
            names.append("--order")
        return tuple(names)


def refuse_wrong_times(seconds: float | None, every_s: float) -> None:
    """Refuse impossible times of a relay.

    Args:
        seconds: duration of the run; None: until Ctrl-C.
        every_s: time between two reports.

    Raises:
        ConfigError: a time is out of bounds.
    """
    is_long_enough = seconds is None or seconds >= _SHORTEST_S
    is_period_possible = _MIN_PERIOD_S <= every_s <= _MAX_PERIOD_S
    if not is_long_enough or not is_period_possible:
        raise ConfigError("--every-s must lie between 0.1 and 3600, --seconds be 0.5 or more.")


def refuse_wrong_seed(seed: int) -> None:
    """Refuse a seed below 0.

    Raises:
        ConfigError: the seed is negative.
    """
    if seed < 0:
        raise ConfigError(f"--seed is {seed}; it must be 0 or more.")
