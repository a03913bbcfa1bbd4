"""Summaries of flight records for ``covey log``: a list of flights, and one record's channels."""

from __future__ import annotations

import contextlib
from collections import Counter
from pathlib import Path
from typing import Any

from groundstation.recording.timeline import Timeline
from groundstation.recording.writer import RECORD_NAME
from onboard.config.file_reading import RESULTS_FILE, json_values, read_bytes
from onboard.config.fleet import ConfigError
from onboard.plain_text import plain_line

_MB = 1e6
MAX_FOLDERS = 2_000  # flights that a list shows
MAX_CHANNELS = 400  # channels that the lines about one record show
# characters that are shown of a verdict
_LONGEST_NAME = 100
_LONGEST_SENTENCE = 4_000


def flight_folders(folder: Path) -> list[Path]:
    """Return the newest flight folders in a folder, the newest first.

    Args:
        folder: folder of flight folders; it may be a flight folder itself.
    """
    folders = [path for path in (folder, *folder.iterdir()) if _has_record(path)]
    folders.sort(key=lambda path: (path / RECORD_NAME).stat().st_mtime, reverse=True)
    return folders[:MAX_FOLDERS]


def _has_record(folder: Path) -> bool:
    """Return whether a folder holds a record; False for a folder that may not be entered."""
    try:
        return (folder / RECORD_NAME).is_file()
    except OSError:
        return False


def summary(folder: Path) -> dict[str, Any]:
    """Return a summary of a flight folder, from the index of its record and its verdict.

    Args:
        folder: flight folder, or its MCAP file.

    Raises:
        ConfigError: there is no record.
    """
    with contextlib.closing(Timeline(folder)) as timeline:
        return _summary(folder, timeline)


def contents(folder: Path) -> dict[str, Any]:
    """Return the :func:`summary` of a flight folder, with the number of messages of each channel.

    The whole record is read, so a damaged piece in its middle is noticed, too.

    Args:
        folder: flight folder, or its MCAP file.

    Raises:
        ConfigError: there is no record.
    """
    counts: Counter[str] = Counter()
    with contextlib.closing(Timeline(folder)) as timeline:
        for number in range(timeline.chunk_count):
            for raw in timeline.raw_messages(number, timeline.topics):
                counts[f"{raw.topic}/{raw.name}"] += 1
        about = _summary(folder, timeline)
    return {**about, "channels": dict(sorted(counts.items()))}


def _summary(folder: Path, timeline: Timeline) -> dict[str, Any]:
    """Return a summary of a record, as whole or damaged as it has been found so far."""
    verdict = written_verdict(timeline.path.parent)
    severities = Counter(event.severity for _, event in timeline.events)
    return {
        "folder": str(folder),
        "length_s": round(timeline.length_s, 1),
        "size_bytes": timeline.path.stat().st_size,
        "vehicles": list(timeline.vehicles),
        "events": len(timeline.events) + timeline.left_out_events,
        "warnings": severities["warning"],
        "critical": severities["critical"],
        "is_whole": not timeline.broken,
        "note": " ".join(timeline.notes),
        "mission": _words(verdict.get("mission"), _LONGEST_NAME),
        "has_passed": verdict.get("passed") if verdict else None,
        "is_interrupted": verdict.get("is_interrupted") is True,
        "verdict": _words(verdict.get("summary"), _LONGEST_SENTENCE),
    }


def list_line(flight: dict[str, Any]) -> str:
    """Return the :func:`summary` of a flight as one line of a list."""
    outcome = "no verdict"
    if flight["has_passed"] is True:
        outcome = "passed"
    elif flight["is_interrupted"]:
        outcome = "interrupted"
    elif flight["has_passed"] is False:
        outcome = "FAILED"
    broken = "" if flight["is_whole"] else "  (cut off or damaged)"
    return (
        f"{flight['folder']:32s} {flight['length_s']:8.1f} s {len(flight['vehicles']):4d} vehicles"
        f" {flight['size_bytes'] / _MB:8.1f} MB  {outcome:11s} {flight['mission']}{broken}"
    )


def info_lines(flight: dict[str, Any]) -> list[str]:
    """Return the :func:`contents` of a flight as lines."""
    counts = flight["channels"]
    length_s = max(flight["length_s"], 1e-3)  # a record of a single stamp has no length
    lines = [
        f"{flight['folder']}: {flight['length_s']:.1f} s, {flight['size_bytes'] / _MB:.1f} MB,"
        f" {flight['events']} events, {flight['warnings']} of them warnings and"
        f" {flight['critical']} critical.",
        f"Vehicles: {', '.join(plain_line(name) for name in flight['vehicles'])}.",
    ]
    lines += [sentence for sentence in (flight["verdict"], flight["note"]) if sentence]
    lines.append(f"{'channel':32s} {'messages':>9s} {'a second':>9s}")
    for channel, count in list(counts.items())[:MAX_CHANNELS]:
        lines.append(f"{plain_line(channel)[:32]:32s} {count:9d} {count / length_s:9.1f}")
    if len(counts) > MAX_CHANNELS:
        lines.append(f"and {len(counts) - MAX_CHANNELS} channels more.")
    return lines


def written_verdict(folder: Path) -> dict[str, Any]:
    """Return the content of a flight folder's ``verdict.json``; empty if it has none to read."""
    with contextlib.suppress(ConfigError):
        if (folder / "verdict.json").is_file():
            value = json_values(read_bytes(folder / "verdict.json", RESULTS_FILE), "verdict.json")
            if isinstance(value, dict):
                return value
    return {}


def _words(value: object, longest: int) -> str:
    """Return a text of a verdict that anybody may have written, at most so many characters."""
    if not isinstance(value, str):
        return ""
    text = plain_line(value)
    if len(text) > longest:
        return f"{text[:longest]}..."
    return text
