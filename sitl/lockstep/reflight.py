"""A recorded lockstep flight, flown again as it was or with changes.

A lockstep flight is repeatable, so its record needs no state of the simulation. It is flown again
from its start, with the files in its folder. Every two seconds a digest of all state is compared
with the digest in the record. While the digests are equal, the flight equals the recorded one. They
differ if Covey, a library or the processor has changed since.

Changes take effect at the start, or at a given second. If the flight differs from the recorded one
before that second, it ends, because the changes would be tried on a different flight.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from groundstation.flights.changes import Change, changed
from groundstation.flights.flight_settings import write_files
from groundstation.flights.recorded_flight import (
    RecordedFlight,
    fleet_of,
    mission_of,
    second_word,
    write_digest,
)
from groundstation.flights.simulation_settings import write_settings
from groundstation.mission_files.mission_findings import refuse_unflyable
from groundstation.recording.timeline import Timeline
from groundstation.verdict.verdict import Verdict
from onboard.config.fleet import ConfigError
from sitl.lockstep.flight import Lockstep
from sitl.lockstep.simulated_flight import (
    longest_stay_s,
    never_happened,
    open_flight,
)
from sitl.lockstep.state_digest import DIGEST_EVERY_S, digest

Say = Callable[[str], None]


class Reflown(NamedTuple):
    """The outcome of a flight that was flown again."""

    verdict: Verdict
    # smallest true distance of two vehicles, at least one of them flying; inf if none
    min_separation_m: float
    flown_s: float
    equal_until_s: float  # until this second its state was equal to the recorded one
    # sentences about faults, orders and changes whose time it did not reach
    never_happened: tuple[str, ...]


class _Comparison:
    """Writes the digests of a flight, and compares them with those of a recorded one.

    Args:
        flight: the flight that is flown; its digests are written if it is recorded.
        digests: the recorded digests by second; empty if there is no recorded flight.
    """

    def __init__(self, flight: Lockstep, digests: dict[str, str]) -> None:
        self._flight = flight
        self._digests = digests
        self.equal_until_s = 0.0  # second of the last digest before any that differs
        self.differs_from_s = math.inf  # second of the first digest that differs
        self._compare_later(DIGEST_EVERY_S)

    def _compare_later(self, at_s: float) -> None:
        self._flight.at(at_s, lambda: self._compare(at_s))

    def _compare(self, at_s: float) -> None:
        own = digest(self._flight.simulation)
        self._write(at_s, own)

        recorded = self._digests.get(second_word(at_s))
        if recorded == own and math.isinf(self.differs_from_s):
            self.equal_until_s = at_s
        elif recorded is not None:
            self.differs_from_s = min(self.differs_from_s, at_s)

        self._compare_later(at_s + DIGEST_EVERY_S)

    def _write(self, at_s: float, own: str) -> None:
        """Write a digest beside the record; as for the record, a failure ends no flight."""
        record = self._flight.record
        if record is None or record.failure is not None:
            return
        try:
            write_digest(record.folder, at_s, own)
        except OSError as error:
            record.fail(error)


def record_digests(flight: Lockstep) -> None:
    """Write the digests of a flight into the folder of its record while it is flown."""
    _Comparison(flight, {})


def fly_again(
    flown: RecordedFlight,
    *,
    folder: Path | None = None,
    resume_at_s: float | None = None,
    changes: Sequence[Change] = (),
    say: Say = lambda line: None,
) -> Reflown:
    """Fly a recorded flight again, as it was or with changes.

    Args:
        flown: the recorded flight.
        folder: an existing folder for the record of the new flight; None records nothing.
        resume_at_s: second at which the changes take effect; None: at the start.
        changes: the changes; empty to repeat the same flight.
        say: called with each line of progress.

    Raises:
        ConfigError: a change is impossible, the recorded flight ended before the changes take
            effect, or the flight differs from it before that.
    """
    if resume_at_s is not None:
        _refuse_later_than_its_end(flown, resume_at_s)
    origin = changed(flown.origin, changes, resume_at_s)
    fleet_path = flown.folder / "fleet.toml"
    fleet = fleet_of(origin.fleet_text, fleet_path)
    fleet.import_law()
    mission = mission_of(flown, origin, fleet)
    refuse_unflyable(mission, is_simulated=True)

    if folder is not None:
        suffix = Path(mission.path).suffix
        write_files(folder, {"fleet.toml": origin.fleet_text, f"mission{suffix}": mission.text})
        write_settings(folder, origin.settings)

    with open_flight(fleet, origin.settings, folder) as flight:
        say(_beginning(flown, folder, resume_at_s))
        flight.say = lambda line: say(f"{flight.time_s:6.1f} s  {line}")
        comparison = _Comparison(flight, flown.digests)
        if resume_at_s is not None:
            flight.at(resume_at_s, lambda: _refuse_another_flight(comparison, resume_at_s))
        verdict = flight.fly(mission, stays=True, longest_stay_s=longest_stay_s(origin.settings))
        if resume_at_s is not None and flight.time_s < resume_at_s:
            raise AnotherFlightError(flight.time_s)

        return Reflown(
            verdict=verdict,
            min_separation_m=flight.min_separation_m,
            flown_s=flight.time_s,
            equal_until_s=comparison.equal_until_s,
            never_happened=tuple(never_happened(origin.settings, flight.time_s)),
        )


def _refuse_later_than_its_end(flown: RecordedFlight, resume_at_s: float) -> None:
    """Refuse changes that would take effect after the end of the recorded flight."""
    with contextlib.closing(Timeline(flown.folder)) as timeline:
        length_s = timeline.length_s
    if resume_at_s > length_s:
        raise ConfigError(
            f"--resume-at is {resume_at_s:g}, but the recorded flight ended at {length_s:.1f} s."
            " Nothing would be changed. Give an earlier second."
        )


def _beginning(flown: RecordedFlight, folder: Path | None, resume_at_s: float | None) -> str:
    """Return a line that says what is flown again, and where its record goes."""
    begins = "from its start"
    if resume_at_s is not None:
        begins = f"as it was until {resume_at_s:g} s"
    line = f"{flown.folder} is flown again, {begins}"
    if folder is None:
        return f"{line}."
    return f"{line}; everything goes to {folder}."


def _refuse_another_flight(comparison: _Comparison, resume_at_s: float) -> None:
    """Raise if the flight has differed from the recorded one before the changes take effect."""
    if comparison.differs_from_s <= resume_at_s:
        raise AnotherFlightError(comparison.differs_from_s)


class AnotherFlightError(ConfigError):
    """The flight differs from the recorded one before any change has taken effect."""

    def __init__(self, from_s: float) -> None:
        super().__init__(
            f"This is another version of Covey or of its libraries, or another machine: the flight"
            f" differs from the recorded one from {from_s:.1f} s on, before anything was changed."
            " Fly the mission anew with --record, and change that flight."
        )
