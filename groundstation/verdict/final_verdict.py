"""The verdict at the end of a recorded flight.

The record is judged too, and the verdict is written beside it.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

from groundstation.recording.flight_report import FlightReport, report
from groundstation.recording.writer import write_json
from groundstation.verdict.expectations import Expect
from groundstation.verdict.observations import FlightObservations
from groundstation.verdict.verdict import Verdict, judge
from onboard.config.fleet import ConfigError


def final_verdict(
    flown: FlightObservations,
    expect: Expect,
    folder: Path,
    *,
    begin_ns: int,
    record_failure: str | None,
) -> Verdict:
    """Judge a flight with its record and write ``verdict.json``.

    Args:
        flown: observations of the runner.
        expect: expectations at the end of the mission.
        folder: of the flight.
        begin_ns: of the record, on the ground's clock [ns].
        record_failure: sentence about a record that ended early.

    Returns:
        The verdict. It is none that passed when the record or the verdict could not be written.
    """
    record: FlightReport | None = None
    with contextlib.suppress(ConfigError):
        record = report(folder, flown.fleet.fleet.height_share)
    record_name = ""
    if record is not None:
        record_name = str(folder)

    def verdict_with(failure: str | None) -> Verdict:
        return judge(flown, expect, record, record_name, begin_ns=begin_ns, record_failure=failure)

    verdict = verdict_with(record_failure)
    write_failure = write_json(folder / "verdict.json", verdict)
    if write_failure is None:
        return verdict
    if record_failure:
        write_failure = f"{record_failure} {write_failure}"
    return verdict_with(write_failure)
