"""Fences of QGroundControl and GeoJSON: read as they are meant, or refused in a sentence."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path
from typing import Any

import pytest

from groundstation.cli import main
from groundstation.starter.fence_files import read_fences, toml_of
from onboard.config import areas
from onboard.config.earth import Origin, latitude_longitude_deg
from onboard.config.fleet import ConfigError, load_fleet
from onboard.config.flight_space import flight_space_of

ORIGIN = Origin(latitude_deg=47.397742, longitude_deg=8.545594, altitude_m=489.4)
SQUARE = ((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0))
POND = (1.5, 1.5)


def degrees(x: float, y: float) -> list[float]:
    return list(latitude_longitude_deg(ORIGIN, x, y))


def plan(**changes: Any) -> dict[str, Any]:
    polygon = {
        "inclusion": True,
        "polygon": [degrees(*corner) for corner in SQUARE],
        "version": 1,
    }
    circle = {
        "circle": {"center": degrees(*POND), "radius": 0.5},
        "inclusion": False,
        "version": 1,
    }
    fence = {"version": 2, "polygons": [polygon], "circles": [circle]} | changes
    return {
        "fileType": "Plan",
        "groundStation": "QGroundControl",
        "version": 1,
        "geoFence": fence,
        "mission": {"items": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
    }


def ring(corners: Any) -> list[list[float]]:
    turned = [degrees(*corner)[::-1] for corner in corners]
    return [*turned, turned[0]]


def geojson(geometry: Any = None, **properties: Any) -> dict[str, Any]:
    hole = ring(((1, 1), (2, 1), (2, 2), (1, 2)))
    shape = geometry or {"type": "Polygon", "coordinates": [ring(SQUARE), hole]}
    feature = {"type": "Feature", "properties": properties or None, "geometry": shape}
    return {"type": "FeatureCollection", "features": [feature]}


def written(folder: Path, content: Any, name: str = "field.plan") -> Path:
    file = folder / name
    file.write_text(content if isinstance(content, str) else json.dumps(content))
    return file


def fleet_file(folder: Path, origin: bool = True) -> Path:
    text = Path("configs/fleets/paper.toml").read_text()
    if origin:
        keys = "latitude_deg = 47.397742, longitude_deg = 8.545594, altitude_m = 489.4"
        text = text.replace('origin = "mocap"', f"origin = {{ {keys} }}")
    file = folder / "fleet.toml"
    file.write_text(text)
    return file


@pytest.mark.parametrize("name", [None, " ", '"""', "\\\x07"])
def test_a_fence_without_a_name_that_can_be_written_has_that_of_its_file(
    tmp_path: Path, name: str | None
) -> None:
    square = {"type": "Polygon", "coordinates": [ring(SQUARE)]}
    fences = read_fences(written(tmp_path, geojson(square, name=name), "field.geojson"))
    assert 'name = "field 1"' in toml_of(fences)


def test_a_plan_becomes_an_area_to_stay_in_and_one_to_stay_out_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleet_file(tmp_path)
    file = written(tmp_path, plan())
    command = ["import", "fence", str(file), "--fleet", str(fleet), "--height", "-1,2.5"]
    assert main([*command, "--buffer", "0.2"]) == 0
    assert not load_fleet(fleet).fences  # nothing is written without --write

    assert main([*command, "--buffer", "0.2", "--write"]) == 0
    field, pond = flight_space_of(load_fleet(fleet)).areas
    assert (field.name, field.keeps_in, field.buffer_m) == ("field 1", True, 0.2)
    assert (field.low_m, field.high_m) == (-1.0, 2.5)
    assert areas.area_m2(field.corners_enu_m) == pytest.approx(36.0, abs=0.02)
    assert (pond.name, pond.keeps_in, pond.radius_m) == ("field 2", False, 0.5)
    assert pond.center_enu_m == pytest.approx(POND, abs=0.002)

    text = fleet.read_text()
    capsys.readouterr()
    assert main([*command, "--write"]) == 2
    assert "has fences named field 1, field 2 already, perhaps of an earlier import. Remove" in (
        " ".join(capsys.readouterr().err.split())
    )
    assert fleet.read_text() == text


@pytest.mark.parametrize("name", ["map.kml", "map.KMZ"])
def test_kml_is_refused_with_what_to_export(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=r"KML is not read\. .* as GeoJSON\.$"):
        read_fences(written(tmp_path, "<kml/>", name))


def test_a_polygon_of_geojson_has_its_longitude_first_and_its_hole_is_to_stay_out_of(
    tmp_path: Path,
) -> None:
    fences = read_fences(written(tmp_path, geojson(name='"the" field')))
    assert [(one.name, one.keep) for one in fences] == [
        ('"the" field', "in"),
        ('"the" field, hole 1', "out"),
    ]
    assert fences[0].polygon_deg is not None
    assert len(fences[0].polygon_deg) == 4
    assert fences[0].polygon_deg[0] == pytest.approx(degrees(*SQUARE[0]))
    assert tomllib.loads(toml_of(fences))["fences"][1]["keep"] == "out"

    tree = {"type": "Point", "coordinates": [*degrees(*POND)[::-1], 30.0]}
    (circle,) = read_fences(written(tmp_path, geojson(tree, keep="out", radius_m=2)))
    assert circle.circle is not None
    assert circle.circle.radius_m == 2.0
    bare = {"type": "Polygon", "coordinates": [ring(SQUARE)]}
    assert len(read_fences(written(tmp_path, bare))) == 1


def a_polygon(**changes: Any) -> dict[str, Any]:
    corners = [degrees(*corner) for corner in SQUARE]
    shape = {"inclusion": True, "polygon": corners, "version": 1} | changes
    return plan(polygons=[shape], circles=[])


WRONG: list[tuple[Any, str]] = [
    ("{", "is no JSON"),
    ("[1, 2]", "it is no table"),
    ("{}", "no .plan of QGroundControl"),
    (
        '{"fileType": "Plan", "version": 1, "geoFence": {"version": 2, "polygons": [{"a": NaN}]}}',
        "is no JSON",
    ),
    ("[" * 500 + "]" * 500, "nested too deeply"),
    (plan() | {"version": 2}, "this .plan has version 2; version 1 can be read"),
    (plan(version=1), "its geoFence has version 1; version 2 can be read"),
    (plan(version=None), "its geoFence has version None"),
    (a_polygon(version=3), "polygon 1 of geoFence has version 3"),
    (a_polygon(inclusion="yes"), "does not say whether it is an inclusion"),
    (a_polygon(polygon=[[47.0, "8"], [47, 8], [48, 8]]), "where a number is needed"),
    (a_polygon(polygon=[[47.0], [47, 8], [48, 8]]), "a point of 1 numbers"),
    (a_polygon(polygon="round"), "is no list"),
    (a_polygon(polygon=[[47.0, 8.0]] * 202), "polygon has 202 corners; 200 are the most"),
    (plan(polygons=[7]), "is no table"),
    (plan(polygons=[], circles=[]), "has no fence"),
    (plan() | {"geoFence": []}, "geoFence is no table"),
    (plan() | {"geoFence": {}}, "has no fence"),
    (plan(polygons=2 * plan()["geoFence"]["polygons"]), "2 areas to stay in"),
    (plan(circles=60 * plan()["geoFence"]["circles"]), "61 fences; 50 are the most"),
    (geojson({"type": "LineString", "coordinates": []}), "is a LineString"),
    (geojson({"type": "Point", "coordinates": [8, 47]}), "Give it a property radius_m"),
    (geojson({"type": "Polygon", "coordinates": []}), "has no corners"),
    (geojson({"type": "Polygon", "coordinates": [[[8, 47, 1, 2]]]}), "a point of 4 numbers"),
    (geojson({"type": "Polygon", "coordinates": [[[8, 47]] * 202]}), "has 202 corners"),
    (geojson(keep="near"), "write 'in' or 'out'"),
    (geojson(keep="out"), "has a hole"),
    (geojson() | {"crs": {"properties": {"name": "EPSG:2056"}}}, "crs is not that of GeoJSON"),
    ({"type": "FeatureCollection", "features": {}}, "is no list"),
    ({"type": "Feature", "geometry": None}, "feature 1 has no geometry. Draw it again, or remove"),
    ({"type": "Feature", "geometry": [7]}, "is no table"),
]


@pytest.mark.parametrize(("content", "words"), WRONG, ids=[words for _, words in WRONG])
def test_a_file_of_another_kind_or_version_is_refused_in_words(
    content: Any, words: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError) as error:
        read_fences(written(tmp_path, content))
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("content", "has_origin", "words"),
    [
        (plan(), False, "the fleet file has no origin"),
        (a_polygon(polygon=[[47.0, 8.0], [47.0, 8.1], [47.1, 8.0]]), True, "km from the fleet"),
        (
            a_polygon(polygon=[degrees(x, y) for x, y in ((0, -3), (3, -3), (3, 3))]),
            True,
            "lies outside",
        ),
        (a_polygon(polygon=[degrees(k, k * k) for k in range(201)]), True, "201 corners"),
    ],
)
def test_a_fence_that_does_not_fit_the_fleet_leaves_its_file_as_it_was(
    content: Any, has_origin: bool, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = fleet_file(tmp_path, has_origin)
    before = fleet.read_text()
    file = written(tmp_path, content)
    assert main(["import", "fence", str(file), "--fleet", str(fleet), "--write"]) == 2
    assert words in capsys.readouterr().err
    assert fleet.read_text() == before


def test_height_is_two_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fleet = fleet_file(tmp_path)
    file = written(tmp_path, plan())
    command = ["import", "fence", str(file), "--fleet", str(fleet)]
    assert main([*command, "--height", "high"]) == 2
    assert "write two heights" in capsys.readouterr().err


def test_a_pipe_is_no_fence(tmp_path: Path) -> None:

    os.mkfifo(tmp_path / "pipe.plan")
    with pytest.raises(ConfigError, match="it is a pipe"):
        read_fences(tmp_path / "pipe.plan")
