"""The verdict at the end of a recorded flight: the record is judged too, and the verdict is written
beside it.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

from groundstation.recording.flight_report import FlightReport, report
from groundstation.recording.writer import write_json
from groundstation.verdict.expectations import Expect
from groundstation.verdict.verdict import FlightObservations, Verdict, judge
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
    name = str(folder) if record is not None else ""
    verdict = judge(flown, expect, record, name, begin_ns=begin_ns, record_failure=record_failure)
    failure = write_json(folder / "verdict.json", verdict)
    if failure is None:
        return verdict
    sentences = " ".join(sentence for sentence in (record_failure, failure) if sentence)
    return judge(flown, expect, record, name, begin_ns=begin_ns, record_failure=sentences)
