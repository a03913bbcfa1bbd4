"""The reference of fleet and mission files, printed from the code: each key's type, default, bounds
and meaning.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from groundstation.formations.frame import FramePoint
from groundstation.mission_files.steps import STEP_BOUNDS, STEPS, OnFailure, Until
from groundstation.shows.gallery import ACCIDENTS, GALLERY, sentence_of
from groundstation.verdict.expectations import EXPECT_MOST_M, Expect
from onboard.config import formation_shape, mocap, people, radio, sitl
from onboard.config.fences import Fence, FenceCircle
from onboard.config.fleet_config import FleetSection, Geofence, Origin, Vehicle
from onboard.config.formation_shape import FormationShape, ShapeName
from onboard.config.law import LawConfig
from onboard.config.law_import import GROUP
from onboard.config.mocap import MocapConfig
from onboard.config.obstacles import Circle, Obstacle
from onboard.config.people import Person
from onboard.config.radio import RadioConfig
from onboard.config.validation import FLEET_BOUNDS, GEOFENCE_BOUNDS, VEHICLE_BOUNDS, law_bounds
from onboard.plain_text import capitalised
from sitl.monte_carlo.open_benchmark import scene_file as scene_structs

Ends = tuple[float | str, float | str]  # a text is another key, or ABOVE_0
ABOVE_0 = "above 0"
_UNITS = {
    "m": "m",
    "s": "s",
    "1_s": "1/s",
    "m_s": "m/s",
    "m_s2": "m/s²",
    "deg": "°",
    "deg_s": "°/s",
    "rad_s": "rad/s",
    "pct": "%",
    "frac": "share",
    "mbit_s": "Mbit/s",
    "kg": "kg",
    "kg_m2": "kg m²",
    "hz": "Hz",
}
_FIELD = re.compile(r"    (\w+): (.+?)(?: = (.+?))?(?:  # (.*))?$")
_ONE_OF_ITS_OWN = ("system_id", "start_enu_m", "agent", "autopilot", "direct", "mocap_body")


def fields(struct: type) -> dict[str, tuple[str, str, str]]:
    """Type, default and meaning of each field, of the parents too, as the source has them."""
    found: dict[str, tuple[str, str, str]] = {}
    for owner in reversed(struct.__mro__):
        if owner is object or owner.__module__.startswith("msgspec"):
            continue
        above: list[str] = []
        for line in inspect.getsource(owner).splitlines()[1:]:
            match = _FIELD.fullmatch(line)
            if match and match[1] in struct.__struct_fields__:  # type: ignore[attr-defined]
                name, kind, default, meaning = match.groups(default="")
                inherited = found.get(name, ("", "", ""))[2]
                found[name] = (kind, default, meaning or " ".join(above) or inherited)
            if line.startswith(("    def ", "    @")):
                break
            above = [*above, line.strip("# ")] if line.startswith("    # ") else []
    return found


def unit(name: str) -> str:
    """Return the unit that a key's name ends with."""
    ends = [end for end in _UNITS if name.endswith(f"_{end}")]
    return _UNITS[max(ends, key=len)] if ends else ""


def _kind(text: str) -> str:
    literal = re.findall(r'"([^"]+)"', text)
    if text == 'bool | Literal["scan"]':
        return 'true, false or `"scan"`'
    if "Literal" in text or text in ("OnLag", "ShapeName", "SystemType | None"):
        return (
            "one of " + ", ".join(f"`{word}`" for word in literal)
            if literal
            else "one of some words"
        )
    words = {
        "float": "number",
        "int": "whole number",
        "str": "text",
        "bool": "true or false",
        "Xyz": "three numbers",
    }
    base = text.removesuffix(" | None")
    if base.startswith("tuple[float"):
        count = base.count("float")
        return f"{('', '', 'two', 'three')[count]} numbers"
    words |= {"tuple[Any, ...]": "list of steps", "tuple[FramePoint, ...]": "list of tables"}
    words |= {"Names": "text or list of texts", "str | tuple[str, ...]": "text or list of texts"}
    words |= {
        "tuple[tuple[float, float], ...]": "list of points",
        "tuple[str, ...]": "list of texts",
        "tuple[int, ...]": "list of whole numbers",
        "tuple[Obstacle, ...]": "list of tables",
    }
    return words.get(base, "table")


def _end(end: float | str) -> str:
    if end == ABOVE_0:
        return ABOVE_0
    if isinstance(end, str):
        return f"`{end}`"
    return f"{end:g}"


def _table(
    struct: type, bounds: Mapping[str, Ends] | Callable[[str], Ends], leave: tuple[str, ...] = ()
) -> str:
    lines = ["| key | type | unit | default | bounds | meaning |", "|---|---|---|---|---|---|"]
    for name, (kind, default, meaning) in fields(struct).items():
        if name in leave:
            continue
        assert meaning, f"{struct.__name__}.{name} has no comment beside it that says its meaning"

        ends: Ends | None = None
        is_number = re.search(r"\b(float|int)\b", kind) is not None and "dict" not in kind
        if not callable(bounds):
            ends = bounds.get(name)
        elif is_number:
            ends = bounds(name)
        limits = ""
        if ends is not None:
            limits = " to ".join(_end(end) for end in ends)

        # a default that is made by a class is not shown
        shown = {"True": "true", "False": "false", "None": "", "{}": ""}.get(default, default)
        if shown and not shown[0].isupper():
            shown = f"`{shown}`"
        elif not default:
            shown = "**required**"
        else:
            shown = ""

        words = _kind(_LITERALS.get(kind, kind))
        lines.append(
            f"| `{name}` | {words} | {unit(name)} | {shown} | {limits} | "
            f"{meaning.replace('|', '/')} |"
        )
    return "\n".join(lines)


def _of(alias: Any) -> str:
    return "Literal[" + ", ".join(f'"{word}"' for word in alias.__args__) + "]"


_LITERALS: dict[str, str] = {}


def fleet_file() -> str:
    """Print the reference of fleet files."""
    from onboard.config.mocap import SystemType

    _LITERALS.update({"ShapeName": _of(ShapeName), "SystemType | None": _of(SystemType)})
    only = tuple(name for name in fields(Vehicle) if name not in _ONE_OF_ITS_OWN)
    parts = [
        ("`[fleet]`", _table(FleetSection, FLEET_BOUNDS)),
        ("`fleet.geofence_m`", _table(Geofence, GEOFENCE_BOUNDS)),
        ("`fleet.origin`, outdoors", _table(Origin, {})),
        (
            "`[vehicles.NAME]`: what only one vehicle has",
            _table(Vehicle, VEHICLE_BOUNDS, ("name", "index", *only)),
        ),
        (
            "`[types.NAME]`, `[defaults]` or `[vehicles.NAME]`",
            _table(Vehicle, VEHICLE_BOUNDS, ("name", "index", *_ONE_OF_ITS_OWN)),
        ),
        ("`[types.NAME.sitl]`: of the emulator only", _table(sitl.SitlProfile, sitl.BOUNDS)),
        (
            "`[formations.NAME]` with a `shape`, here or in a mission",
            _table(FormationShape, formation_shape.BOUNDS),
        ),
        ("`[mocap]`", _table(MocapConfig, mocap.BOUNDS)),
        ("`[people.NAME]`: mocap.md", _table(Person, people.BOUNDS)),
        ("`[radio]`", _table(RadioConfig, radio.BOUNDS)),
        ("`[[obstacles]]`", _table(Obstacle, {})),
        ("`circle` of an obstacle", _table(Circle, {})),
        (
            "`[[fences]]`, within `fleet.geofence_m`: fences.md",
            _table(Fence, {"buffer_m": (0.0, 100.0)}),
        ),
        ("`circle` of a fence", _table(FenceCircle, {"radius_m": (0.0, 10000.0)})),
        ("`[law]`", _table(LawConfig, law_bounds)),
    ]
    return "\n\n".join(f"### {title}\n\n{table}" for title, table in parts)


def mission_file() -> str:
    """Print the reference of mission files."""
    from groundstation.orders.intents import Assign
    from groundstation.orders.path_orders import OnLag

    _LITERALS["Assign"] = _of(Assign)
    _LITERALS["OnLag"] = _of(OnLag)
    most: dict[str, Ends] = {key: (ABOVE_0, high) for key, high in EXPECT_MOST_M.items()}
    steps = []
    for name, kind in STEPS.items():
        summary = " ".join(str(inspect.getdoc(kind)).partition("\n\n")[0].split())
        body = _table(
            kind, {**STEP_BOUNDS, **most}, leave=("do", *getattr(kind, "planned_fields", ()))
        )
        steps.append(
            f'### `do = "{name}"`\n\n{summary}' + (f"\n\n{body}" if body.count("\n") > 1 else "")
        )
    shown = (("a point of `to`", FramePoint), ("`until` and `when`", Until))
    inner = [f"### {title}\n\n{_table(struct, STEP_BOUNDS)}" for title, struct in shown]
    tables = [
        *inner,
        f"### `[expect]`\n\n{_table(Expect, most)}",
        f"### `[on_failure]`\n\n{_table(OnFailure, {})}",
    ]
    return "\n\n".join([*steps, *tables])


def scene_file() -> str:
    """Print the reference of scenes of the open benchmark."""
    parts = [
        ("A scene", scene_structs.Scene),
        ("`placing` of type `circle`", scene_structs.Circle),
        ("`placing` of type `square`", scene_structs.Square),
        ("`placing` of type `listed`", scene_structs.Listed),
        ("One of `obstacles`", scene_structs.Obstacle),
        ("`intruder`", scene_structs.Intruder),
        ("`others`", scene_structs.Others),
    ]
    lines = []
    for title, struct in parts:
        summary = " ".join(str(inspect.getdoc(struct)).split())
        lines.append(f"### {title}\n\n{summary}\n\n{_table(struct, scene_structs.BOUNDS)}")
    return "\n\n".join(lines)


def scenes() -> str:
    """Print the scenes of the open benchmark."""
    lines = ["| scene | what happens |", "|---|---|"]
    for name in scene_structs.names():
        lines.append(f"| `{name}` | {scene_structs.packaged(name).about} |")
    return "\n".join(lines)


_BUILT_IN = {
    "covey": "Covey's law: [the law](law.md)",
    "paper": "the paper's law of two vehicles, from which Covey's grew",
    "off": "no avoidance at all",
}


def open_laws() -> str:
    """Print the laws of the open benchmark, those of other people with their papers."""
    lines = ["| law | what it does, and where it comes from |", "|---|---|"]
    for name, words in _BUILT_IN.items():
        lines.append(f"| `{name}` | {words} |")
    for law in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        if law.value.startswith("sitl."):
            words = str(inspect.getdoc(import_module(law.module)))
            lines.append(f"| `{law.name}` | {' '.join(words.split()).replace('|', '¦')} |")
    return "\n".join(lines)


def gallery() -> str:
    """Print the missions of the gallery with their pictures."""
    parts = []
    for name in (*GALLERY, *ACCIDENTS):
        title, _, words = sentence_of(name).partition(": ")
        shown = "the ways from above, and the closest pair"
        if name in ACCIDENTS:
            shown = "without the defence, and with it"
        parts.append(f"## {title}\n\n{capitalised(words)}\n\n    covey demo gallery {name}\n")
        parts.append(f"![{title}: {shown}](figures/gallery-{name}.png)\n")
    return "\n".join(parts).strip()
