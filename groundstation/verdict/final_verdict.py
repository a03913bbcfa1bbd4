"""The verdict at the end of a recorded flight.

It is made of the live observations and of the record, and is written into the record's folder.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from groundstation.recording.flight_report import FlightReport, report
from groundstation.recording.timeline import Timeline
from groundstation.recording.writer import RecordEnd, write_json
from groundstation.verdict.expectations import Expect
from groundstation.verdict.observations import FlightObservations
from groundstation.verdict.verdict import Verdict, judge
from onboard.config.fleet import ConfigError
from onboard.plain_text import numbered


def final_verdict(
    flown: FlightObservations,
    expect: Expect,
    folder: Path,
    record_end: RecordEnd,
    earlier: Sequence[Verdict] = (),
) -> Verdict:
    """Judge a mission with the flight's record and write ``verdict.json``.

    If several missions were flown in one flight, the file has the verdict on the first mission that
    has failed, or on the last one if none has; under ``missions`` it has the verdicts on all.

    Args:
        flown: observations of the runner.
        expect: expectations at the end of the mission.
        folder: folder of the flight.
        record_end: end of the record, as its writer reports it.
        earlier: verdicts on the missions before this one in the same flight.

    Returns:
        The verdict. It has not passed if the record or the verdict could not be written, or if the
        record cannot be read back completely.
    """
    record: FlightReport | None = None
    record_name = ""
    failures = [record_end.failure]
    try:
        # A record without messages cannot be read, and lacks nothing: nobody was heard.
        if record_end.written or record_end.failure is not None:
            fleet = flown.fleet
            record = report(folder, fleet.fleet.height_share, flown.begin_ns, people=fleet.people)
        record_name = str(folder)
        if record_end.failure is None:
            failures.append(_missing_sentence(folder, record_end.written))
            failures.append(_dropped_sentence(record_end.dropped))
    except ConfigError as error:
        if record_end.failure is None:
            failures.append(f"The record cannot be read. {error}")
    except OSError as error:
        failures.append(
            f"The record cannot be read ({error.strerror or error}). Look at the disk of {folder}, "
            "and at its permissions."
        )

    def judged_so_far() -> Verdict:
        sentences = [failure for failure in failures if failure]
        return judge(
            flown,
            expect,
            record,
            record_name,
            begin_ns=record_end.begin_ns,
            record_failure=" ".join(sentences),
        )

    verdict = judged_so_far()
    write_failure = write_json(folder / "verdict.json", _content([*earlier, verdict]))
    if write_failure is None:
        return verdict
    failures.append(write_failure)
    return judged_so_far()


def _content(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Return the content of ``verdict.json`` for the missions of one flight."""
    decisive = next((verdict for verdict in verdicts if not verdict.passed), verdicts[-1])
    content: dict[str, Any] = msgspec.to_builtins(decisive)
    if len(verdicts) > 1:
        content["missions"] = msgspec.to_builtins(verdicts)
    return content


def _dropped_sentence(dropped: int) -> str | None:
    """Return a sentence if messages were not written because the disk was too slow; else None."""
    if not dropped:
        return None
    return (
        f"The record lacks {numbered(dropped, 'message')}, because the disk was too slow for them. "
        "Record to a faster disk."
    )


def _missing_sentence(folder: Path, written: int) -> str | None:
    """Return a sentence if a record has fewer messages than were written into it; else None."""
    if not written:
        return None
    with contextlib.closing(Timeline(folder)) as timeline:
        count = timeline.count_messages()
    if count >= written:
        return None
    return (
        f"The record holds {count} of the {written} messages that were written: the disk has lost "
        f"the others or cannot read them, or something has changed {folder} during the flight. "
        "Look at the disk, and for programs that write there."
    )
