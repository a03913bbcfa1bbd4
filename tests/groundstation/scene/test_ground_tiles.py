"""Pictures of the ground: which tiles of a folder are taken, where they lie, what is refused."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path

import msgspec
import pytest

from groundstation.report.report_page import policy
from groundstation.scene.ground_tiles import (
    MAX_TILES,
    GroundTiles,
    ground_message,
    read_ground_tiles,
)
from onboard.config.earth import Origin
from onboard.config.fleet import ConfigError, FleetConfig, Geofence, load_fleet

ROOT = Path(__file__).resolve().parents[3]
ZURICH = Origin(latitude_deg=47.397742, longitude_deg=8.545594, altitude_m=489.4)


def png(side_px: int = 4, padding: int = 0) -> bytes:
    """A grey picture; padding makes its file larger."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", side_px, side_px, 8, 0, 0, 0, 0)
    rows = zlib.compress(b"".join(b"\0" + b"\x80" * side_px for _ in range(side_px)))
    parts = [chunk(b"IHDR", header), chunk(b"IDAT", rows), chunk(b"teXt", bytes(padding))]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts) + chunk(b"IEND", b"")


def outdoors(origin: Origin = ZURICH, size_m: float = 60.0) -> FleetConfig:
    """A fleet whose fence is a square of twice the size around its origin."""
    fleet = load_fleet(ROOT / "configs" / "fleets" / "px4-sitl.toml")
    fence = Geofence(x=(-size_m, size_m), y=(-size_m, size_m), z=(-1.0, 30.0))
    section = msgspec.structs.replace(fleet.fleet, origin=origin, geofence_m=fence)
    return msgspec.structs.replace(fleet, fleet=section)


def put(folder: Path, zoom: int, x: int, y: int, data: bytes = b"") -> None:
    """Write a tile."""
    path = folder / str(zoom) / str(x) / f"{y}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data or png())


def tile_of(origin: Origin, zoom: int) -> tuple[int, int]:
    """The tile in which a place lies, by the formulas of the tiles' makers."""
    latitude = math.radians(origin.latitude_deg)
    x = (origin.longitude_deg + 180.0) / 360.0 * 2**zoom
    y = (1.0 - math.log(math.tan(latitude) + 1.0 / math.cos(latitude)) / math.pi) / 2.0 * 2**zoom
    return int(x) % 2**zoom, int(y)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Tiles of zoom 17 and 19 around the origin, of which some are missing; and other files."""
    for zoom in (17, 19):
        x, y = tile_of(ZURICH, zoom)
        for dx in (-1, 0, 1):
            put(tmp_path, zoom, x + dx, y)
    (tmp_path / "attribution.txt").write_text("Made by\n a  surveyor \x1b[31m 2026\n")
    (tmp_path / "readme").write_text("no zoom")
    (tmp_path / "99").mkdir()
    return tmp_path


def test_the_finest_zoom_that_covers_the_fence_with_few_tiles_is_taken(folder: Path) -> None:
    ground = read_ground_tiles(folder, outdoors())
    assert len(ground.tiles) == 3
    assert "surveyor" in ground.attribution
    assert "\x1b" not in ground.attribution

    for tile in ground.tiles:
        (west, north), (east, _), (_, south), _ = tile.corners_enu_m
        assert east - west == pytest.approx(76.4 * math.cos(math.radians(47.4)), abs=0.3)
        assert north - south == pytest.approx(east - west, abs=0.1)
    middle = [
        tile
        for tile in ground.tiles
        if tile.corners_enu_m[0][0] <= 0.0 <= tile.corners_enu_m[1][0]
        and tile.corners_enu_m[2][1] <= 0.0 <= tile.corners_enu_m[0][1]
    ]
    assert len(middle) == 1

    # a field of 1 km takes too many of zoom 19
    (wide, *_) = read_ground_tiles(folder, outdoors(size_m=500.0)).tiles
    (west, _), (east, _), *_ = wide.corners_enu_m
    assert east - west == pytest.approx(4 * 76.4 * math.cos(math.radians(47.4)), abs=1.0)


@pytest.mark.parametrize(
    "origin",
    [
        Origin(latitude_deg=-16.8, longitude_deg=179.9999, altitude_m=0.0),
        Origin(latitude_deg=84.9, longitude_deg=-179.9999, altitude_m=0.0),
        Origin(latitude_deg=-33.86, longitude_deg=151.21, altitude_m=0.0),
    ],
)
def test_tiles_are_found_at_the_date_line_and_in_the_south(tmp_path: Path, origin: Origin) -> None:
    x, y = tile_of(origin, 16)
    put(tmp_path, 16, x, y)
    (tile,) = read_ground_tiles(tmp_path, outdoors(origin)).tiles
    (west, north), (east, _), (_, south), _ = tile.corners_enu_m
    assert west <= 0.0 <= east
    assert south <= 0.0 <= north


def test_a_page_asks_its_server_or_holds_the_pictures_itself(folder: Path) -> None:
    ground = read_ground_tiles(folder, outdoors())
    asked = ground_message(ground, is_inside_page=False)
    held = ground_message(ground, is_inside_page=True)
    assert asked is not None
    assert held is not None
    assert [tile["source"] for tile in asked["tiles"]] == ["tiles/0", "tiles/1", "tiles/2"]
    assert all(tile["source"].startswith("data:image/png;base64,iVBOR") for tile in held["tiles"])
    assert ground_message(None, is_inside_page=True) is None


def test_a_report_may_show_pictures_only_where_it_has_some() -> None:
    assert "img-src" not in policy([], [])
    assert "img-src data:" in policy([], [], has_pictures=True)
    assert "http" not in policy([], [], has_pictures=True)


def test_what_is_no_folder_of_tiles_is_refused_in_words(tmp_path: Path) -> None:
    fleet = outdoors()
    with pytest.raises(ConfigError, match="no such folder"):
        read_ground_tiles(tmp_path / "nowhere", fleet)
    with pytest.raises(ConfigError, match=r"no tile of it covers the fence.* such as \d+/\d+/\d+"):
        read_ground_tiles(tmp_path, fleet)

    put(tmp_path, 18, 0, 0)
    with pytest.raises(ConfigError, match="no tile of it covers the fence"):
        read_ground_tiles(tmp_path, fleet)
    with pytest.raises(ConfigError, match="has no origin on Earth"):
        read_ground_tiles(tmp_path, load_fleet(ROOT / "configs" / "fleets" / "paper.toml"))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"GIF89a" + bytes(40), "is no PNG"),
        (b"\x89PNG\r\n\x1a\n", "is no PNG"),
        (png(side_px=2000), "2000 x 2000 pixels"),
        (png(padding=1_100_000), "larger|MB"),
    ],
    ids=["GIF", "head only", "many pixels", "many bytes"],
)
def test_a_tile_that_is_no_picture_or_too_large_is_refused(
    tmp_path: Path, data: bytes, words: str
) -> None:
    x, y = tile_of(ZURICH, 18)
    put(tmp_path, 18, x, y, data)
    with pytest.raises(ConfigError, match=words):
        read_ground_tiles(tmp_path, outdoors())


def test_tiles_that_are_too_large_together_are_refused(tmp_path: Path) -> None:
    x, y = tile_of(ZURICH, 19)
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            put(tmp_path, 19, x + dx, y + dy, png(padding=950_000))
    with pytest.raises(ConfigError, match="more than 8 MB"):
        read_ground_tiles(tmp_path, outdoors())


def test_a_field_as_large_as_a_country_takes_no_more_tiles(tmp_path: Path) -> None:
    for zoom in range(20):
        put(tmp_path, zoom, *tile_of(ZURICH, zoom))
    ground: GroundTiles = read_ground_tiles(tmp_path, outdoors(size_m=9000.0))
    assert 1 <= len(ground.tiles) <= MAX_TILES
