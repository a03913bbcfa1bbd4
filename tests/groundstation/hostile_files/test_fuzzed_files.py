"""Files that differ from good ones somewhere are read or refused in words: nothing else happens.

The good ones are a show, paths, lights, a fleet file, a mission and parameters. Hypothesis replaces
some of their values by others, or writes bytes that are nothing.
"""

from __future__ import annotations

import contextlib
import copy
import json
import tempfile
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groundstation.shows.light_program import colours
from groundstation.shows.skyc import read_skyc
from onboard.config.fleet import ConfigError
from tests.groundstation.hostile_files.reading import DOORS, outcome_of
from tests.groundstation.shows.made_shows import line_of, trajectory

CONFIGS = Path(__file__).resolve().parents[3] / "configs"
DAILY = settings(
    max_examples=40, deadline=None, suppress_health_check=list(HealthCheck), database=None
)
MANY = settings(DAILY, max_examples=3000)

NUMBERS = st.one_of(
    st.integers(),
    st.sampled_from([0, -1, 7, 255, 2**31, 2**63, 10**30, 10**400]),
    st.floats(),
    st.sampled_from([1e300, -1e300, 1e-300, 1e12, float("nan"), float("inf")]),
)
TEXTS = st.one_of(
    st.text(max_size=12), st.sampled_from(["", "nan", "../x", "\x00", "\ud800", "a.b"])
)
SCALARS = st.one_of(NUMBERS, TEXTS, st.booleans())
TOML_VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=6), inner, max_size=3)
    ),
    max_leaves=6,
)
JSON_VALUES = st.one_of(st.none(), TOML_VALUES)


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the way to each value within a value."""
    parts: Any = ()
    if isinstance(value, dict):
        parts = value.items()
    elif isinstance(value, list):
        parts = enumerate(value)
    for key, part in parts:
        yield (*at, key)
        yield from places(part, (*at, key))


@st.composite
def changed(draw: st.DrawFn, good: Any, values: st.SearchStrategy[Any]) -> Any:
    """A good value of which one to three parts are replaced or left out."""
    data = copy.deepcopy(good)
    for _ in range(draw(st.integers(1, 3))):
        *way, last = draw(st.sampled_from(list(places(data))))
        inner = data
        for key in way:
            inner = inner[key]
        if draw(st.booleans()):
            inner[last] = draw(values)
        else:
            del inner[last]
        if not data:
            break
    return data


def good_show() -> dict[str, Any]:
    """Two drones with yaw and lights, one of which begins later."""
    drones = []
    for index, (name, at) in enumerate(line_of(2, 8.0).items()):
        settings = {
            "name": name,
            "home": [*at(0.0)[:2], 0.0],
            "trajectory": trajectory(at, 8.0, step_s=2.0) | {"takeoffTime": 0.5 * index},
            "yawControl": {"version": 1, "setpoints": [[0.0, 0.0], [4.0, 90.0]]},
            "lights": {"version": 1, "data": "BP8AAGQA"},
        }
        drones.append({"type": "generic", "settings": settings})
    return {
        "version": 1,
        "meta": {"title": "a show"},
        "environment": {"type": "indoor", "location": {"origin": ["47.4", "8.5", "400"]}},
        "swarm": {"drones": drones},
    }


GOOD_FLEET = tomllib.loads((CONFIGS / "fleets" / "paper.toml").read_text(encoding="utf-8"))
GOOD_MISSION = tomllib.loads((CONFIGS / "missions" / "paper.toml").read_text(encoding="utf-8"))


def skyc(data: Any) -> bytes:
    """A show with this content."""
    with tempfile.TemporaryFile() as file:
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr("show.json", json.dumps(data).encode("utf-8", "surrogatepass"))
        file.seek(0)
        return file.read()


def toml(data: Any) -> bytes:
    """A TOML file with this content."""
    return tomli_w.dumps(data).encode("utf-8", "surrogatepass")


CELLS = st.one_of(
    st.floats().map(repr), st.integers(-3, 300).map(str), st.text(max_size=4), st.just('"')
)
HEADS = st.sampled_from(
    [
        "t,x,y,z,yaw",
        "Time [msec],x [m],y [m],z [m],Red,Green,Blue",
        "x,y,z,speed",
        "t,red,green,blue",
        '""',
        ",",
    ]
)
# mostly rows of rising times and plain numbers, so that files are read to their end
PLAIN_CELLS = st.one_of(st.floats(-50.0, 250.0).map(repr), st.integers(0, 255).map(str))
ROWS = st.lists(
    st.lists(st.one_of(PLAIN_CELLS, PLAIN_CELLS, PLAIN_CELLS, CELLS), min_size=3, max_size=4),
    max_size=6,
)


def csv_text(head: str, rows: list[list[str]]) -> str:
    """A CSV whose rows are as long as its first line says, with rising times."""
    width = head.count(",") + 1
    lines = [head]
    for number, row in enumerate(rows):
        cells = [str(number), *row, *row][:width]
        lines.append(",".join(cells))
    return "\n".join(lines)


CSVS = st.builds(csv_text, HEADS, ROWS)
PARAMETER_ROWS = st.tuples(
    st.sampled_from(["1", "2", "255", "x"]),
    st.just("1"),
    st.sampled_from(["MAV_SYS_ID", "MPC_XY_P", "", "lower"]),
    CELLS,
    st.sampled_from(["6", "9", "7"]),
).map("\t".join)
PARAMETERS = st.lists(
    st.one_of(PARAMETER_ROWS, PARAMETER_ROWS, st.text(max_size=9)), max_size=4
).map("\n".join)


def encoded(text: str) -> bytes:
    """The bytes of a text, also of one that UTF-8 does not have."""
    return text.encode("utf-8", "surrogatepass")


# door -> ending of its file, and what its content is made of
FUZZED: dict[str, tuple[str, st.SearchStrategy[bytes]]] = {
    "fleet": (".toml", changed(GOOD_FLEET, TOML_VALUES).map(toml)),
    "mission": (".toml", changed(GOOD_MISSION, TOML_VALUES).map(toml)),
    "path": (".csv", CSVS.map(encoded)),
    "lights": (".csv", CSVS.map(encoded)),
    "params": (".params", PARAMETERS.map(encoded)),
}
ENDINGS = {"show": ".skyc", "record": ".mcap", "replay": ".mcap", "picture": ".png", "font": ".ttf"}


def open_once(door: str, ending: str, content: bytes) -> None:
    """Open one file; it must be read or refused."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"fuzzed{ending}"
        path.touch(mode=0o600)  # keys that others can read are refused
        path.write_bytes(content)
        outcome = outcome_of(door, path)
    assert outcome.kind in ("read", "refused"), outcome


@pytest.mark.parametrize("door", FUZZED)
def test_a_good_file_with_other_values_is_read_or_refused(door: str) -> None:
    _fuzz(door, DAILY)


@pytest.mark.long
@pytest.mark.parametrize("door", FUZZED)
def test_many_good_files_with_other_values_are_read_or_refused(door: str) -> None:
    _fuzz(door, MANY)


def _fuzz(door: str, how: settings) -> None:
    ending, contents = FUZZED[door]

    @how
    @given(contents)
    def run(content: bytes) -> None:
        open_once(door, ending, content)

    run()


@DAILY
@given(changed(good_show(), JSON_VALUES))
def test_a_show_with_other_values_is_read_or_refused(data: Any) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fuzzed.skyc"
        path.write_bytes(skyc(data))
        with contextlib.suppress(ConfigError):
            read_skyc(path)


@pytest.mark.long
def test_many_shows_with_other_values_are_imported_or_refused() -> None:
    def imported(data: Any) -> None:
        open_once("show", ".skyc", skyc(data))

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "good.skyc"
        path.write_bytes(skyc(good_show()))
        assert outcome_of("show", path).kind == "read", "what is changed has to be good"

    settings(MANY, max_examples=500)(given(changed(good_show(), JSON_VALUES))(imported))()


@DAILY
@given(st.binary(max_size=60))
def test_a_light_program_of_any_bytes_is_read_or_refused(data: bytes) -> None:
    try:
        colours(data, 60.0)
    except ConfigError:
        raise
    except ValueError:
        pass


@pytest.mark.parametrize("door", [door for door in DOORS if door != "law"])
def test_bytes_that_are_nothing_are_read_or_refused(door: str) -> None:
    _open_bytes(door, settings(DAILY, max_examples=20))


@pytest.mark.long
@pytest.mark.parametrize("door", [door for door in DOORS if door != "law"])
def test_many_bytes_that_are_nothing_are_read_or_refused(door: str) -> None:
    _open_bytes(door, MANY)


def _open_bytes(door: str, how: settings) -> None:
    heads = st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"PK\x05\x06", b"\x89MCAP0\r\n", b"GIF89a"])
    ending = ENDINGS.get(door, ".toml")

    @how
    @given(heads, st.one_of(st.binary(max_size=200), TEXTS.map(encoded)))
    def run(head: bytes, rest: bytes) -> None:
        open_once(door, ending, head + rest)

    run()
