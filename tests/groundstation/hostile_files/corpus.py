"""Files that somebody made to hurt whoever opens them, and files that are merely broken.

Each is small or quickly made, and each was read with a traceback, with gigabytes or without end
once.
"""

from __future__ import annotations

import base64
import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from tests.groundstation.recorded import record
from tests.groundstation.shows.made_shows import line_of, trajectory

_SCENE_OF_MANY = (
    b'{"schema": 1, "name": "many", "about": "Many.", "placing": '
    b'{"type": "square", "vehicles": %d, "side_m": 29.5, "spacing_m": 1.4}'
)
_PILLAR = b'{"begin_enu_m": [0, 0], "radius_m": 50}'
_PILLARS = b', "obstacles": [' + b", ".join([_PILLAR] * 500) + b"]}"


class HostileFile(NamedTuple):
    """One file of the corpus."""

    door: str  # of reading.py, which opens it
    make: Callable[[Path], Path]  # writes it into a folder
    outcome: str = "refused"
    is_slow_to_make: bool = False


def _show(folder: Path, members: dict[str, str | bytes]) -> Path:
    path = folder / "hostile.skyc"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def _drone(seconds: float = 12.0, **settings: Any) -> dict[str, Any]:
    at = line_of(1, seconds)["D1"]
    return {
        "settings": {
            "name": "D1",
            "home": [*at(0.0)[:2], 0.0],
            "trajectory": trajectory(at, seconds),
            **settings,
        }
    }


def _beginning(after_s: float) -> dict[str, Any]:
    """A second drone, whose path begins so long after the show."""
    at = line_of(2, 12.0)["D2"]
    moving = trajectory(at, 12.0) | {"takeoffTime": after_s}
    return _drone(name="D2", home=[*at(0.0)[:2], 0.0], trajectory=moving)


def show_of(*drones: Any, **whole: Any) -> Callable[[Path], Path]:
    """A show with these drones."""

    def make(folder: Path) -> Path:
        data = {"version": 1, "swarm": {"drones": list(drones)}, **whole}
        return _show(folder, {"show.json": json.dumps(data)})

    return make


def changed_points(change: Callable[[list[Any]], None]) -> Callable[[Path], Path]:
    """A show of one drone whose points are changed."""
    drone = _drone()
    change(drone["settings"]["trajectory"]["points"])
    return show_of(drone)


def _seven_controls(points: list[Any]) -> None:
    points[1][2] = [[1.0, 2.0, 3.0]] * 7


def _controls_no_list(points: list[Any]) -> None:
    points[1][2] = 7


def _many_digits(points: list[Any]) -> None:
    points[1][1][0] = 10**400


def _long_time(points: list[Any]) -> None:
    points[-1][0] = 1e12


def _huge_position(points: list[Any]) -> None:
    points[3][1][0] = 1e300


def _json_of_brackets(folder: Path) -> Path:
    return _show(folder, {"show.json": "[" * 200_000})


def _bomb_of_empty_lists(folder: Path) -> Path:
    lists = "[" + "[]," * 28_000_000 + "[]]"
    return _show(folder, {"show.json": '{"version": 1, "swarm": ' + lists + "}"})


def _bomb_of_light_programs(folder: Path) -> Path:
    # two loops within each other: 60,000 colours of each drone
    inner = bytes([12, 200, 12, 150, 6, 1, 7, 1, 13, 13, 0])
    data = base64.b64encode(inner).decode()
    drones = []
    for k in range(200):
        drone = _drone(lights={"version": 1, "data": data})
        drone["settings"]["name"] = f"D{k}"
        drone["settings"]["home"] = [3.0 * k, 0.0, 0.0]
        drones.append(drone)
    return show_of(*drones)(folder)


def _many_members(folder: Path) -> Path:
    path = folder / "hostile.skyc"
    with zipfile.ZipFile(path, "w") as archive:
        for k in range(150_000):
            archive.writestr(f"{k}", b"")
    return path


def _lzma_member(folder: Path) -> Path:
    path = folder / "hostile.skyc"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("show.json", b" " * 250_000_000)
    return path


def _csv_of(text: str | bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / "hostile.csv"
        if isinstance(text, str):
            path.write_text(text, encoding="utf-8")
        else:
            path.write_bytes(text)
        return path

    return make


def _long_line(folder: Path) -> Path:
    path = folder / "hostile.csv"
    with path.open("wb") as file:
        file.write(b"t,x,y,z\n0,0,0,1\n")
        for _ in range(300):
            file.write(b"1" * 1_000_000)
    return path


def _long_field(folder: Path) -> Path:
    return _csv_of("t,x,y,z\n0,0,0,1\n1,0,0," + "1" * 200_000 + "\n")(folder)


def _folder_with_pipe(folder: Path) -> Path:
    inner = folder / "show"
    inner.mkdir()
    os.mkfifo(inner / "drone1.csv")
    return inner


def _pipe(ending: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / f"pipe{ending}"
        os.mkfifo(path, 0o600)
        return path

    return make


def _endless(ending: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / f"endless{ending}"
        path.symlink_to("/dev/zero")
        return path

    return make


def _kernel_log(ending: str) -> Callable[[Path], Path]:
    """A regular file by its kind, from which nothing can be read at a place."""

    def make(folder: Path) -> Path:
        path = folder / f"kernel{ending}"
        path.symlink_to("/proc/kmsg")
        return path

    return make


def _toml(text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / "hostile.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return make


def _deep(depth: int = 100_000) -> str:
    return "schema = 1\nx = " + "[" * depth + "]" * depth + "\n"


def _formation_way(points: str) -> Callable[[Path], Path]:
    """A mission of the paper's fleet with the way of a formation."""
    return _toml(
        "schema = 1\n[[step]]\ndo = 'takeoff'\n[[step]]\ndo = 'fly_formation'\nname = 'triangle'\n"
        f"position_enu_m = [0, 0, 1]\nto = [{points}]\n"
    )


def _python(text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / "hostile.py"
        path.write_text(text, encoding="utf-8")
        return path

    return make


def _png_part(kind: bytes, data: bytes) -> bytes:
    crc = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", crc)


def png_head(width: int, height: int) -> bytes:
    """The begin of a picture of eight bits for each channel."""
    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _png_part(b"IHDR", head)


def png(width: int, height: int) -> bytes:
    """A white picture, in few bytes."""
    packer = zlib.compressobj(1)
    row = b"\0" + b"\xff" * (4 * width)
    data = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    return png_head(width, height) + _png_part(b"IDAT", data) + _png_part(b"IEND", b"")


def _picture(width: int, height: int) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / "hostile.png"
        path.write_bytes(png(width, height))
        return path

    return make


def _bytes(name: str, data: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(data)
        return path

    return make


def _record(compression: str, content: bytes) -> bytes:
    """The bytes of a record with one chunk."""
    packed = content
    if compression == "zstd":
        packed = import_module("zstandard").compress(content)
    elif compression == "lz4":
        packed = import_module("lz4.frame").compress(content)
    head = struct.pack("<QQQI", 0, 1, len(content), 0)
    head += struct.pack("<I", len(compression)) + compression.encode()
    chunk = head + struct.pack("<Q", len(packed)) + packed
    out = io.BytesIO()
    out.write(b"\x89MCAP0\r\n")
    out.write(struct.pack("<BQ", 1, 8) + struct.pack("<II", 0, 0))
    out.write(struct.pack("<BQ", 6, len(chunk)) + chunk)
    return out.getvalue()


def _bomb_record(compression: str) -> Callable[[Path], Path]:
    message = struct.pack("<BQHIQQ", 5, 22, 1, 0, 0, 0)

    def make(folder: Path) -> Path:
        content = message * (200_000_000 // len(message))
        path = folder / "flight.mcap"
        path.write_bytes(_record(compression, content))
        return folder

    return make


def _record_with_huge_length(folder: Path) -> Path:
    head = struct.pack("<QQQI", 0, 1, 8, 0) + struct.pack("<I", 0)
    chunk = head + struct.pack("<Q", 1 << 62)
    data = b"\x89MCAP0\r\n" + struct.pack("<BQ", 1, 8) + struct.pack("<II", 0, 0)
    data += struct.pack("<BQ", 6, len(chunk)) + chunk
    (folder / "flight.mcap").write_bytes(data)
    return folder


def _flight_with(name: str, content: bytes | None) -> Callable[[Path], Path]:
    """A flight folder in which one file holds this; None: a pipe stands in its place."""

    def make(folder: Path) -> Path:
        flight = record(folder / "flight", 1.0)
        path = flight / name
        path.unlink(missing_ok=True)
        path.parent.mkdir(exist_ok=True)
        if content is None:
            os.mkfifo(path)
        else:
            path.write_bytes(content)
        return flight

    return make


def _simulated(**settings: Any) -> Callable[[Path], Path]:
    """A flight folder whose flight was simulated with these settings."""
    values = {"is_lockstep": True, **settings}
    return _flight_with("simulation.json", json.dumps(values).encode())


def _link_to_itself(folder: Path) -> Path:
    path = folder / "flights.jsonl"
    path.symlink_to(path)
    return path


_PX4_LOG = "px4/mav0-2026-01-01_00_00_00.ulg"
_KEPT = b'{"fleet":"a"}\n'

CORPUS = {
    # shows
    "a point with seven control points": HostileFile("show", changed_points(_seven_controls)),
    "control points that are no list": HostileFile("show", changed_points(_controls_no_list)),
    "a number of 400 digits": HostileFile("show", changed_points(_many_digits)),
    "a show one of whose drones begins after 11 days": HostileFile(
        "show", show_of(_drone(), _beginning(1e6))
    ),
    "a show one of whose drones has begun 30 years ago": HostileFile(
        "show", show_of(_drone(), _beginning(-1e9))
    ),
    "a show of 1e12 seconds": HostileFile("show", changed_points(_long_time)),
    "a position of 1e300 metres": HostileFile("show", changed_points(_huge_position)),
    "yaw setpoints that are no pairs": HostileFile(
        "show", show_of(_drone(yawControl={"setpoints": [7, None]}))
    ),
    "yaw setpoints whose times fall": HostileFile(
        "show", show_of(_drone(yawControl={"setpoints": [[9, 1], [2, 5], [4, 1]]}))
    ),
    "a yaw of 1e300 degrees": HostileFile(
        "show", show_of(_drone(yawControl={"setpoints": [[0, 0], [3, 1e300]]}))
    ),
    "an origin that is nan": HostileFile(
        "show",
        show_of(
            _drone(),
            environment={"type": "outdoor", "location": {"origin": ["nan", float("nan")]}},
        ),
    ),
    "a show that lists a million times nothing": HostileFile(
        "show", _bomb_of_empty_lists, is_slow_to_make=True
    ),
    "lights that loop, 200 drones": HostileFile("show", _bomb_of_light_programs),
    "JSON nested 200,000 deep": HostileFile("show", _json_of_brackets),
    "a zip of 150,000 members": HostileFile("show", _many_members, is_slow_to_make=True),
    "a zip packed with LZMA": HostileFile("show", _lzma_member, is_slow_to_make=True),
    "a show that is a pipe": HostileFile("show", _pipe(".skyc")),
    "a show that never ends": HostileFile("show", _endless(".skyc")),
    "a show that is the log of the kernel": HostileFile("show", _kernel_log(".skyc")),
    "a folder of CSVs with a pipe": HostileFile("show", _folder_with_pipe),
    # paths, lights, slots
    "a CSV with a line of 300 MB": HostileFile("path", _long_line, is_slow_to_make=True),
    "a CSV with a field of 200 kB": HostileFile("path", _long_field),
    "a CSV of zeros": HostileFile("path", _csv_of(b"\0" * 1000)),
    "a CSV of 1e12 seconds": HostileFile("path", _csv_of("t,x,y,z\n0,0,0,1\n1e12,0,0,2\n")),
    "a CSV of waypoints at 1e-9 m/s": HostileFile(
        "path", _csv_of("x,y,z,speed\n0,0,1,1\n5,0,1,1e-9\n9,0,1,1\n")
    ),
    "a CSV of 1e300 metres": HostileFile("path", _csv_of("t,x,y,z\n0,0,0,1\n1,1e300,0,2\n")),
    "pieces of 1e300 metres": HostileFile(
        "path",
        _csv_of(
            "duration,"
            + ",".join(f"{a}^{k}" for a in ("x", "y", "z", "yaw") for k in range(8))
            + "\n1"
            + ",1e300" * 32
            + "\n"
        ),
    ),
    "a CSV with an open quotation mark": HostileFile(
        "path", _csv_of('t,x,y,z\n0,0,0,1\n1,"0,0,2\n' + "2,0,0,2\n" * 100_000)
    ),
    "a CSV of 64 MB": HostileFile(
        "path", _csv_of("t,x,y,z\n" + "1,1,1,1\n" * 8_000_000), is_slow_to_make=True
    ),
    "a CSV that never ends": HostileFile("path", _endless(".csv")),
    "lights that are a pipe": HostileFile("lights", _pipe(".csv")),
    # pictures and fonts
    "a picture whose head says 30,000 x 30,000": HostileFile(
        "picture", _bytes("hostile.png", png_head(30_000, 30_000))
    ),
    "a picture of 30,000 x 30,000": HostileFile(
        "picture", _picture(30_000, 30_000), is_slow_to_make=True
    ),
    "a picture of 12,000 x 12,000": HostileFile(
        "picture", _picture(12_000, 12_000), is_slow_to_make=True
    ),
    "a picture of 1 x 2,000,000": HostileFile(
        "picture", _picture(1, 2_000_000), is_slow_to_make=True
    ),
    "a picture that is a pipe": HostileFile("picture", _pipe(".png")),
    "a picture that never ends": HostileFile("picture", _endless(".png")),
    "a font that is a pipe": HostileFile("font", _pipe(".ttf")),
    "a font of zeros": HostileFile("font", _bytes("font.ttf", b"\0" * 5000)),
    # fleet and mission files
    "a fleet file nested 100,000 deep": HostileFile("fleet", _toml(_deep())),
    "a fleet file with a name of 100,000 parts": HostileFile(
        "fleet", _toml("schema = 1\n" + ".".join(["a"] * 100_000) + " = 1\n")
    ),
    "a fleet file with a table of 100,000 parts": HostileFile(
        "fleet", _toml("schema = 1\n[" + ".".join(['"a"'] * 100_000) + "]\n")
    ),
    "a fleet file with a number of 5,000 digits": HostileFile(
        "fleet", _toml("schema = 1\nx = " + "9" * 5000 + "\n")
    ),
    "a fleet file with a key of 900,000 letters": HostileFile(
        "fleet", _toml("schema = 1\n" + "x" * 900_000 + " = 1\n[fleet]\nname = 'x'\n")
    ),
    "a fleet file with a list of 1,900,000 numbers": HostileFile(
        "fleet", _toml("x = [" + "1," * 1_900_000 + "]\n")
    ),
    "a vehicle whose type is a list": HostileFile(
        "fleet", _toml("schema = 1\n[fleet]\nname = 'x'\n[vehicles.a]\ntype = [[7]]\n")
    ),
    "a fleet file of 40,000 vehicles": HostileFile(
        "fleet",
        _toml(
            "schema = 1\n[fleet]\nname = 'x'\n"
            + "".join(f"[vehicles.v{k}]\nsystem_id = {k % 255 + 1}\n" for k in range(40_000))
        ),
    ),
    "a fleet file of 100 MB": HostileFile("fleet", _toml("# " + "x" * 100_000_000)),
    "a fleet file that is a pipe": HostileFile("fleet", _pipe(".toml")),
    "a fleet file that is the log of the kernel": HostileFile("fleet", _kernel_log(".toml")),
    "a fleet file that never ends": HostileFile("fleet", _endless(".toml")),
    "a mission nested 100,000 deep": HostileFile("mission", _toml(_deep())),
    "a mission nested 900 deep": HostileFile("mission", _toml(_deep(300))),
    "a formation that turns by 1e300 degrees": HostileFile(
        "mission", _formation_way("{ turn_deg = 1e300 }")
    ),
    "a formation's way of many hours": HostileFile(
        "mission", _formation_way("{ turn_deg = 9, duration_s = 3600 }," * 900)
    ),
    "a formation's way of 9,000 points": HostileFile(
        "mission", _formation_way("{ turn_deg = 9, name = 'triangle' }," * 9000)
    ),
    "a Python mission nested 100,000 deep": HostileFile(
        "mission", _python("x = " + "(" * 100_000 + ")" * 100_000)
    ),
    "a Python mission of 100,000 signs": HostileFile(
        "mission", _python("async def mission(fleet):\n    pass\nEXPECT = " + "-" * 100_000 + "1\n")
    ),
    "a Python mission that never ends": HostileFile("mission", _endless(".py")),
    "a Python mission that is a pipe": HostileFile("mission", _pipe(".py")),
    # records
    "a record that unpacks to 200 MB, zstd": HostileFile(
        "record", _bomb_record("zstd"), outcome="read", is_slow_to_make=True
    ),
    "a record that unpacks to 200 MB, lz4": HostileFile(
        "record", _bomb_record("lz4"), outcome="read", is_slow_to_make=True
    ),
    "a record with a length of 4e18": HostileFile(
        "record", _record_with_huge_length, outcome="read"
    ),
    "a replay that unpacks to 200 MB, zstd": HostileFile(
        "replay", _bomb_record("zstd"), outcome="read", is_slow_to_make=True
    ),
    # what lies beside a record
    "settings of a simulation nested 100,000 deep": HostileFile(
        "flown", _flight_with("simulation.json", b"[" * 100_000)
    ),
    "settings of a simulation that are a pipe": HostileFile(
        "flown", _flight_with("simulation.json", None)
    ),
    "a simulation with gusts of nan": HostileFile("flown", _simulated(gust_m_s=float("nan"))),
    "a simulation with a seed of 400 digits": HostileFile("flown", _simulated(seed=10**400)),
    "a simulated mission with a name of 3 MB": HostileFile(
        "flown", _simulated(mission_path="x." + "y" * 3_000_000)
    ),
    "a simulated mission with control characters in its name": HostileFile(
        "flown", _simulated(mission_path="\x1b[31m[red]\n\0")
    ),
    "a verdict nested 100,000 deep": HostileFile(
        "log info", _flight_with("verdict.json", b'{"a":' * 100_000), outcome="read"
    ),
    "a verdict that is a pipe": HostileFile(
        "log info", _flight_with("verdict.json", None), outcome="read"
    ),
    "a log of PX4 that is a pipe, beside a record": HostileFile(
        "log info", _flight_with(_PX4_LOG, None), outcome="read"
    ),
    "a record that is a pipe": HostileFile("log info", _flight_with("flight.mcap", None)),
    "a log of PX4 that is a pipe": HostileFile("log info", _pipe(".ulg")),
    "a log of PX4 that never ends": HostileFile("log info", _endless(".ulg")),
    "a record to identify whose fleet file is nested 100,000 deep": HostileFile(
        "identify", _flight_with("fleet.toml", _deep().encode())
    ),
    "a record to compare with whose verdict never fits": HostileFile(
        "report", _flight_with("verdict.json", b'{"passed": NaN, "a": 1e400}'), outcome="read"
    ),
    # evidence
    "evidence nested 100,000 deep": HostileFile(
        "evidence", lambda folder: _bytes("evidence.json", b'{"x":' * 100_000)(folder).parent
    ),
    "kept flights nested 100,000 deep": HostileFile(
        "kept flights",
        _bytes("flights.jsonl", _KEPT + b'{"x":' + b"[" * 100_000),
        outcome="read",
    ),
    "kept flights that are a pipe": HostileFile("kept flights", _pipe(".jsonl")),
    "kept flights that are a link to itself": HostileFile("kept flights", _link_to_itself),
    # parameters, keys, results
    "parameters that never end": HostileFile("params", _endless(".params")),
    "parameters that are a pipe": HostileFile("params", _pipe(".params")),
    "parameters in a line of 30 MB": HostileFile("params", _bytes("x.params", b"1\t" * 15_000_000)),
    "a certificate that never ends": HostileFile("certificate", _endless(".pem")),
    "a certificate that is a pipe": HostileFile("certificate", _pipe(".pem")),
    "a key that is a pipe": HostileFile("key", _pipe(".key")),
    "a MAVLink key that is a pipe": HostileFile("mavlink key", _pipe(".key")),
    "results nested 200,000 deep": HostileFile(
        "results", _bytes("map.jsonl", b'{"law_map": ' + b"[" * 200_000 + b"\n")
    ),
    "results that never end": HostileFile("results", _endless(".jsonl")),
    "results that are a pipe": HostileFile("results", _pipe(".jsonl")),
    "scene nested 200,000 deep": HostileFile(
        "scene", _bytes("scene.json", b'{"schema": 1, "name": ' + b"[" * 200_000)
    ),
    "scene that never ends": HostileFile("scene", _endless(".json")),
    "scene that is a pipe": HostileFile("scene", _pipe(".json")),
    "scene of a million vehicles": HostileFile(
        "scene", _bytes("scene.json", _SCENE_OF_MANY % 1_000_000 + b"}")
    ),
    "scene whose square is full of pillars": HostileFile(
        "scene", _bytes("scene.json", _SCENE_OF_MANY % 250 + _PILLARS)
    ),
    "a law that is a pipe": HostileFile("law", _pipe(".py")),
    "a message to the web's socket, nested 60,000 deep": HostileFile(
        "web", _bytes("message.json", b"[" * 60_000), outcome="read"
    ),
}
