"""Files of bytes, fences and scripts that differ from good ones are read or refused in words.

A good file of each kind is small. Hypothesis changes some of its bytes, leaves some out, puts
others in, or cuts it; of fences it changes values. Pictures are also built with other chunks, whose
checksums are right, because a wrong checksum ends the reading at once.
"""

from __future__ import annotations

import datetime
import functools
import json
import struct
import tempfile
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from matplotlib import font_manager

from groundstation.evidence.kept_flights import KeptFlights
from groundstation.keys import authority
from onboard.config import file_reading
from onboard.config.file_reading import FileKind
from onboard.config.fleet import load_fleet
from sitl.monte_carlo import open_benchmark
from sitl.monte_carlo.law_map import results_file
from tests.groundstation.evidence.campaigns import evidence, flown
from tests.groundstation.hostile_files.reading import DOORS, outcome_of
from tests.groundstation.hostile_files.test_fuzzed_files import JSON_VALUES, changed, open_once
from tests.groundstation.px4_logs.made_up_logs import log_bytes
from tests.groundstation.recorded import record
from tests.groundstation.starter.test_fence_files import geojson, plan
from tests.onboard.corrections.rtcm_frames import framed, recording

OPEN_SCENES = Path(open_benchmark.__file__).parent / "scenes"
DAILY = settings(
    max_examples=10, deadline=None, suppress_health_check=list(HealthCheck), database=None
)
MANY = settings(DAILY, max_examples=1500)

_PNG_BEGIN = b"\x89PNG\r\n\x1a\n"
_MORE_CHUNKS = (b"IHDR", b"PLTE", b"tRNS", b"iCCP", b"zTXt", b"eXIf", b"acTL", b"fcTL")
_NUMBERS = (1005, 1006, 1077, 1087, 1230, 4095)  # of messages of RTCM

# kind of file -> the doors of reading.py that open it
DOORS_OF_KIND = {
    "FLEET_FILE": ("fleet",),
    "MISSION_FILE": ("mission",),
    "SCRIPT": ("script", "mission"),
    "CSV_FILE": ("path", "lights"),
    "SHOW_FILE": ("show",),
    "PICTURE": ("picture",),
    "FONT": ("font",),
    "FENCE_FILE": ("fence",),
    "PARAMETER_FILE": ("params",),
    "KEY_FILE": ("certificate", "key", "mavlink key"),
    "RTCM_FILE": ("rtcm",),
    "SCENE_FILE": ("scene",),
    "RESULTS_FILE": ("results", "log info"),
    "EVIDENCE_FILE": ("evidence", "kept flights"),
    "SIMULATION_FILE": ("flown",),
    "ULOG": ("px4 log", "log info"),
    "RECORD": ("record", "replay"),
}
# kinds without a format of their own
WITHOUT_FORMAT = {
    "LAW_SOURCE": "Python that runs with its user's rights",
    "PASSWORD_FILE": "one line of text",
    "OUTPUT_FILE": "only compared with how such files begin, before it is overwritten",
    "MAP_TILE": "passed on as it is; only width and height are read",
    "TILE_ATTRIBUTION": "one line of text",
}


def test_each_kind_of_file_has_a_door_that_is_tried_with_other_bytes() -> None:
    kinds = {name for name, value in vars(file_reading).items() if isinstance(value, FileKind)}
    assert kinds == {*DOORS_OF_KIND, *WITHOUT_FORMAT}
    for doors in DOORS_OF_KIND.values():
        assert {*doors} <= {*DOORS}


def _chunk(kind: bytes, data: bytes) -> bytes:
    checksum = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)


def good_picture() -> bytes:
    """A grey picture of 6 x 4 pixels, whose left half is dark."""
    head = struct.pack(">IIBBBBB", 6, 4, 8, 0, 0, 0, 0)
    rows = (b"\0" + b"\x10" * 3 + b"\xf0" * 3) * 4
    parts = [_chunk(b"IHDR", head), _chunk(b"IDAT", zlib.compress(rows)), _chunk(b"IEND", b"")]
    return _PNG_BEGIN + b"".join(parts)


@functools.cache
def good_record() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return (record(Path(folder) / "flight", 0.4) / "flight.mcap").read_bytes()


def good_script() -> bytes:
    return b"""from pycrazyswarm import Crazyswarm
TIME = 2.5
swarm = Crazyswarm()
for cf in swarm.allcfs.crazyflies:
    cf.takeoff(targetHeight=1.0, duration=TIME)
    cf.uploadTrajectory(0, 0, None)
    cf.startTrajectory(0, timescale=0.5 * TIME)
swarm.timeHelper.sleep(TIME)
"""


def good_scene() -> bytes:
    return (OPEN_SCENES / "corridor.json").read_bytes()


@functools.cache
def good_font() -> bytes:
    return Path(font_manager.findfont("DejaVu Sans")).read_bytes()


@functools.cache
def good_keys() -> tuple[bytes, bytes]:
    """A certificate and its private key."""
    with tempfile.TemporaryDirectory() as folder:
        keys = Path(folder) / "keys"
        authority.make_authority(keys, "paper", datetime.datetime.now(datetime.UTC))
        return (keys / "ca.pem").read_bytes(), (keys / authority.AUTHORITY_KEY).read_bytes()


def good_results() -> bytes:
    row = {"cell": "swap2 mocap", "stage": 0, "ratio": [1.1, 1.2]}
    row |= dict.fromkeys(results_file.MAP.numbers, 1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.jsonl"
        with results_file.ResultsFile(path, "1") as results:
            results.add(row)
        return path.read_bytes()


def good_flights() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flights.jsonl"
        kept = KeptFlights(path, {"fleet": "a"})
        kept.keep(flown())
        kept.keep(flown("agent killed", 1))
        return path.read_bytes()


def good_evidence() -> bytes:
    return msgspec.json.encode(evidence(load_fleet("configs/fleets/paper.toml"), [flown()]))


GOOD: dict[str, Callable[[], bytes]] = {
    "picture": good_picture,
    "record": good_record,
    "replay": good_record,
    "px4 log": lambda: log_bytes(length_s=0.2, start_s=300.0),
    "rtcm": lambda: recording(2),
    "script": good_script,
    "fence": lambda: json.dumps(geojson()).encode(),
    "scene": good_scene,
    "font": good_font,
    "certificate": lambda: good_keys()[0],
    "key": lambda: good_keys()[1],
    "mavlink key": lambda: bytes(range(1, 33)),
    "results": good_results,
    "kept flights": good_flights,
    "evidence": good_evidence,
}
ENDINGS = {
    "picture": ".png",
    "record": ".mcap",
    "replay": ".mcap",
    "px4 log": ".ulg",
    "rtcm": ".rtcm3",
    "script": ".py",
    "fence": ".geojson",
    "scene": ".json",
    "font": ".ttf",
    "certificate": ".pem",
    "key": ".pem",
    "mavlink key": ".key",
    "results": ".jsonl",
    "kept flights": ".jsonl",
    "evidence": ".json",
}


@st.composite
def mutated(draw: st.DrawFn, good: bytes) -> bytes:
    """Bytes of which one to four places are changed."""
    data = bytearray(good)
    for _ in range(draw(st.integers(1, 4))):
        place = draw(st.integers(0, max(0, len(data) - 1)))
        other = draw(st.binary(min_size=1, max_size=8))
        match draw(st.sampled_from(["change", "leave out", "put in", "cut", "repeat"])):
            case "change":
                data[place : place + len(other)] = other
            case "leave out":
                del data[place : place + len(other)]
            case "put in":
                data[place:place] = other
            case "repeat":
                data[place:place] = data[place : place + 64]
            case "cut":
                del data[place:]
    return bytes(data)


@pytest.mark.parametrize("door", GOOD)
def test_a_good_file_with_other_bytes_is_read_or_refused(door: str, tmp_path: Path) -> None:
    path = tmp_path / f"good{ENDINGS[door]}"
    path.touch(mode=0o600)  # keys that others can read are refused
    path.write_bytes(GOOD[door]())
    assert outcome_of(door, path).kind == "read", "what is changed has to be good"
    _fuzz(door, mutated(GOOD[door]()), DAILY)


@pytest.mark.long
@pytest.mark.parametrize("door", GOOD)
def test_many_good_files_with_other_bytes_are_read_or_refused(door: str) -> None:
    _fuzz(door, mutated(GOOD[door]()), MANY)


PIXELS = st.one_of(
    st.binary(max_size=60).map(zlib.compress),
    st.integers(0, 100_000).map(lambda count: zlib.compress(bytes(count))),
    st.binary(max_size=30),
)
CHUNKS = st.lists(
    st.one_of(
        st.tuples(st.just(b"IDAT"), PIXELS),
        st.tuples(
            st.sampled_from(_MORE_CHUNKS),
            st.binary(max_size=40),
        ),
    ).map(lambda part: _chunk(*part)),
    max_size=5,
).map(b"".join)
SIDES_PX = st.one_of(st.integers(0, 9), st.sampled_from([5000, 30_000, 2**31 - 1, 2**32 - 1]))
PICTURES = st.builds(
    lambda width_px, height_px, depth, colours, chunks: (
        _PNG_BEGIN
        + _chunk(b"IHDR", struct.pack(">IIBBBBB", width_px, height_px, depth, colours, 0, 0, 0))
        + chunks
        + _chunk(b"IEND", b"")
    ),
    SIDES_PX,
    SIDES_PX,
    st.sampled_from([1, 2, 4, 8, 16, 3]),
    st.sampled_from([0, 2, 3, 4, 6, 1]),
    CHUNKS,
)
FENCES = st.one_of(changed(plan(), JSON_VALUES), changed(geojson(), JSON_VALUES)).map(
    lambda data: json.dumps(data).encode("utf-8", "surrogatepass")
)
SCENES = changed(json.loads(good_scene()), JSON_VALUES).map(
    lambda data: json.dumps(data).encode("utf-8", "surrogatepass")
)
# frames whose checksums are right
FRAMES = st.lists(
    st.tuples(st.sampled_from(_NUMBERS), st.binary(max_size=40)),
    max_size=4,
).map(
    lambda parts: b"".join(
        framed(((number << 4) | 0xA).to_bytes(2, "big") + rest) for number, rest in parts
    )
)
BUILT: dict[str, tuple[str, st.SearchStrategy[bytes]]] = {
    "a picture": ("picture", PICTURES),
    "a fence": ("fence", FENCES),
    "a scene": ("scene", SCENES),
    "frames": ("rtcm", FRAMES),
}


@pytest.mark.parametrize("name", BUILT)
def test_a_file_with_other_parts_is_read_or_refused(name: str) -> None:
    _fuzz(*BUILT[name], DAILY)


@pytest.mark.long
@pytest.mark.parametrize("name", BUILT)
def test_many_files_with_other_parts_are_read_or_refused(name: str) -> None:
    _fuzz(*BUILT[name], MANY)


def _fuzz(door: str, contents: st.SearchStrategy[bytes], how: Any) -> None:
    @how
    @given(contents)
    def run(content: bytes) -> None:
        with warnings.catch_warnings(action="error"):  # a user reads one sentence and no more
            open_once(door, ENDINGS[door], content)

    run()


@pytest.mark.long
def test_a_report_is_written_beside_a_log_that_is_cut_at_any_byte(tmp_path: Path) -> None:
    flight = record(tmp_path / "flight", 1.0)
    (flight / "px4").mkdir()
    log = flight / "px4" / "mav0-2026-01-01_00_00_00.ulg"
    data = log_bytes(length_s=0.2, start_s=300.0)
    for count in range(len(data) + 1):
        log.write_bytes(data[:count])
        outcome = outcome_of("report", flight)
        assert outcome.kind == "read", (count, outcome)
