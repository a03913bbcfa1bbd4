"""Formations from shapes, texts, images and files, and who takes which of their slots."""

from __future__ import annotations

import itertools
import math
import os
import struct
import tomllib
import warnings
import zlib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.formations import shapes, slot_drawing
from groundstation.formations.assignment import least_longest, least_sum, spots_without_crossing
from groundstation.formations.slots import formation_slots, stretched
from groundstation.orders.grammar import OrderError, parse
from groundstation.orders.held_formation import HeldFormation
from groundstation.orders.intents import Formation
from groundstation.orders.plan import PlannedOrder, plan_order
from groundstation.starter.starter_files import Answers, starter
from onboard.config.fleet import ConfigError, FleetConfig, fleet_from_mapping, parking_distance_m

TWELVE = tomllib.loads(starter(Answers(vehicles=12)).fleet_text)
PLAIN = ("line", "column", "v", "wedge", "circle", "grid", "polygon", "sphere")


def fleet_with(path: str = "fleet.toml", **formations: dict[str, Any]) -> FleetConfig:
    wide = {"x": [-40.0, 40.0], "y": [-40.0, 40.0], "z": [0.0, 20.0]}
    return fleet_from_mapping(
        {**TWELVE, "fleet": {**TWELVE["fleet"], "geofence_m": wide}, "formations": formations},
        path=path,
    )


def ordered(fleet: FleetConfig, line: str) -> PlannedOrder:
    return plan_order(
        parse(line, fleet), fleet, None, held=HeldFormation(None), author="x", now_ns=0
    )


def nearest_m(slots: dict[str, Any]) -> float:
    return min(math.dist(p[:2], q[:2]) for p, q in itertools.combinations(slots.values(), 2))


def test_a_file_of_slots_that_changes_is_read_again(tmp_path: Path) -> None:
    file = tmp_path / "slots.csv"
    fleet = fleet_with(
        str(tmp_path / "fleet.toml"),
        own={"shape": "csv", "file": "slots.csv", "vehicles": "mav0,mav1"},
    )
    for apart_m in (2, 35):
        file.write_text(f"x,y\n0,0\n{apart_m},0\n")
        assert formation_slots(fleet, "own")["mav1"] == (apart_m, 0.0, 0.0)


@pytest.mark.parametrize("shape", PLAIN)
@pytest.mark.parametrize(
    "extra",
    [{}, {"rotation_deg": 33.0, "spacing_m": 2.0}, {"layers": 3}],
    ids=["", "turned", "layers"],
)
def test_a_shape_has_a_slot_for_each_and_keeps_their_distance(
    shape: str, extra: dict[str, Any]
) -> None:
    fleet = fleet_with(it={"shape": shape, **extra})
    slots = formation_slots(fleet, "it")
    assert tuple(slots) == fleet.enabled_names
    assert nearest_m(slots) == pytest.approx(
        extra.get("spacing_m", 1.15 * parking_distance_m(fleet)), abs=2e-3
    )
    heights = {z for _, _, z in slots.values()}
    assert min(heights) == 0.0
    assert len(heights) == {"sphere": len(slots)}.get(shape, extra.get("layers", 1))
    assert not ordered(fleet, "formation it 0 0 1").refusals


@given(count=st.integers(1, 40), opening=st.floats(20.0, 150.0), sides=st.integers(3, 12))
@settings(max_examples=40, deadline=None)
def test_no_two_slots_of_a_shape_are_at_one_spot(count: int, opening: float, sides: int) -> None:
    made = [
        shapes.v(count, opening),
        shapes.wedge(count, opening),
        shapes.polygon(count, sides),
        shapes.grid(count, None),
    ]
    for slots in (
        *made,
        shapes.line(count),
        shapes.column(count),
        shapes.circle(count),
        shapes.sphere(count),
    ):
        assert slots.shape == (count, 3)
        assert shapes.nearest_m(slots) > 0.05


def test_layers_that_stand_above_each_other_are_refused_with_the_reason() -> None:
    planned = ordered(
        fleet_with(it={"shape": "circle", "layers": 2, "layer_height_m": 2.0, "stacked": True}),
        "formation it 0 0 1",
    )
    assert not planned.orders
    assert any("no vertical separation" in reason for reason in planned.refusals.values())


@pytest.mark.parametrize("text", ["", " ", "\u200b"])
def test_a_text_in_which_nothing_is_drawn_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="no visible letter"):
        slot_drawing.text_slots(text, None, 3)


def test_a_text_between_dollar_signs_is_no_mathematics() -> None:
    dollars = slot_drawing.text_slots("$2$", None, 12)
    assert not np.array_equal(dollars, slot_drawing.text_slots("2", None, 12))
    slot_drawing.text_slots("$\\frac$", None, 12)
    slot_drawing.text_slots("5 $", None, 12)


def test_a_text_with_letters_that_the_font_lacks_is_refused_with_these_letters() -> None:
    with pytest.raises(ConfigError, match="The font DejaVu Sans has no '日', '本' for the text"):
        slot_drawing.text_slots("日本 A日", None, 3)


def test_two_slots_of_an_image_take_two_pixels_though_one_is_nearest_to_both(
    tmp_path: Path,
) -> None:
    from matplotlib.image import imsave

    picture = np.ones((6, 4, 3))
    for row, column in ((1, 0), (1, 3), (2, 2), (4, 2)):
        picture[row, column] = 0.0
    imsave(tmp_path / "dots.png", picture)

    first, second = slot_drawing.image_slots(str(tmp_path / "dots.png"), 2)
    assert math.dist(first, second) >= 1.0


def test_a_picture_with_a_damaged_part_behind_its_pixels_is_refused(tmp_path: Path) -> None:
    def part(kind: bytes, data: bytes) -> bytes:
        checksum = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)

    file = tmp_path / "damaged.png"
    file.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + part(b"IHDR", struct.pack(">IIBBBBB", 2, 2, 8, 0, 0, 0, 0))
        + part(b"IDAT", zlib.compress(bytes(6)))
        + part(b"iCCP", b"x\0")
        + part(b"IEND", b"")
    )
    with pytest.raises(ConfigError, match="this image cannot be read"):
        slot_drawing.image_slots(str(file), 2)


def test_a_wrong_animation_in_an_image_prints_no_warning(tmp_path: Path) -> None:
    from matplotlib.image import imsave

    file = tmp_path / "dot.png"
    picture = np.ones((6, 4, 3))
    picture[2, 2] = 0.0
    imsave(file, picture)
    animation = struct.pack(">I4s8sI", 8, b"acTL", b"", zlib.crc32(b"acTL" + bytes(8)))
    end = file.read_bytes()[-12:]
    file.write_bytes(file.read_bytes()[:-12] + animation + end)

    with warnings.catch_warnings(action="error"):
        slot_drawing.image_slots(str(file), 1)


def test_fonts_that_are_none_leave_no_file_open(tmp_path: Path) -> None:
    font = tmp_path / "font.ttf"
    font.write_bytes(b"nothing")
    open_files = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        with pytest.raises(ConfigError, match="cannot be read"):
            slot_drawing.text_slots("A", str(font), 2)
    assert len(os.listdir("/proc/self/fd")) < open_files + 20


def test_a_text_and_an_image_are_drawn_by_their_slots(tmp_path: Path) -> None:
    from matplotlib.image import imsave

    letter = slot_drawing.text_slots("I", None, 5)
    assert np.ptp(letter[:, 0]) < 0.2 * np.ptp(letter[:, 1])  # a line from south to north
    assert slot_drawing.text_slots("-", None, 4)[:, 1].std() < 1.5
    picture = np.ones((40, 60, 3))
    picture[5:10, 10:55] = 0.0
    imsave(tmp_path / "bar.png", picture)
    fleet = fleet_with(
        str(tmp_path / "fleet.toml"),
        bar={"shape": "image", "file": "bar.png"},
        hi={"shape": "text", "text": "HI"},
    )
    bar = np.array(list(formation_slots(fleet, "bar").values()))
    assert np.ptp(bar[:, 0]) > 4.0 * np.ptp(bar[:, 1])
    assert nearest_m(formation_slots(fleet, "hi")) == pytest.approx(
        1.15 * parking_distance_m(fleet), abs=1e-3
    )


def test_a_csv_is_taken_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "two.csv").write_text("x [cm],y [cm],z [cm]\n0,0,0\n150,0,20\n")
    formation = {"shape": "csv", "file": "two.csv", "vehicles": "0-1"}
    slots = formation_slots(fleet_with(str(tmp_path / "fleet.toml"), it=formation), "it")
    assert slots == {"mav0": (0.0, 0.0, 0.0), "mav1": (1.5, 0.0, 0.2)}


@pytest.mark.parametrize(
    ("formation", "words"),
    [
        ({"shape": "blob"}, "formations.it.shape"),
        ({"shape": "line", "spaceing_m": 1}, "formations.it.spaceing_m"),
        ({"shape": "line", "spacing_m": -1.0}, "formations.it.spacing_m"),
        ({"shape": "polygon", "sides": 2}, "formations.it.sides"),
        ({"shape": "text"}, "formations.it.text"),
        ({"shape": "image"}, "formations.it.file"),
    ],
)
def test_a_wrong_shape_is_refused_when_the_file_is_read(
    formation: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        fleet_with(it=formation)


@pytest.mark.parametrize(
    ("formation", "words"),
    [
        ({"shape": "csv", "file": "none.csv"}, "no such file"),
        ({"shape": "image", "file": "none.png"}, "no such image"),
        ({"shape": "text", "text": "  \t a", "font": "none.ttf"}, "font"),
        ({"shape": "line", "vehicles": "mav99"}, "mav99"),
    ],
)
def test_what_cannot_be_made_is_refused_when_it_is_ordered(
    formation: dict[str, Any], words: str
) -> None:
    with pytest.raises(OrderError, match=words):
        parse("formation it 0 0 1", fleet_with(it=formation))


def test_a_spacing_stretches_slots_above_each_other_with_those_beside_them() -> None:
    slots = {"a": (0, 0, 0), "b": (1, 0, 0), "c": (0, 0, 1.5), "d": (1, 0, 1.5)}
    wider = stretched(slots, 3.0)
    assert wider == {"a": (0, 0, 0), "b": (3, 0, 0), "c": (0, 0, 1.5), "d": (3, 0, 1.5)}

    assert stretched({"a": (1, 0, 0)}, 3.0) == {"a": (1, 0, 0)}
    pile = {"a": (1, 0, 0), "b": (1, 0, 2), "c": (1, 0, 4)}
    assert stretched(pile, None, 180.0)["c"] == pytest.approx((-1, 0, 4))
    with pytest.raises(ConfigError, match=r"All 3 slots are above each other.* spacing of 2 m"):
        stretched(pile, 2.0)


def test_slots_too_near_for_the_law_are_refused() -> None:
    planned = ordered(fleet_with(it={"shape": "line", "spacing_m": 0.6}), "formation it 0 0 1")
    assert not planned.orders
    assert "keeps" in planned.refusals["mav0"]


@given(
    st.integers(1, 6).flatmap(
        lambda n: st.lists(st.floats(0.0, 9.0), min_size=n * n, max_size=n * n)
    )
)
@settings(max_examples=150, deadline=None)
def test_assignments_are_the_best_of_all(costs: list[float]) -> None:
    table = np.array(costs).reshape((math.isqrt(len(costs)), -1))
    count = len(table)
    every = [
        [table[row, column] for row, column in enumerate(order)]
        for order in itertools.permutations(range(count))
    ]
    assert least_longest(table) == pytest.approx(min(max(one) for one in every))
    places = least_sum(table)
    assert sorted(places) == list(range(count))
    assert sum(table[row, column] for row, column in enumerate(places)) == pytest.approx(
        min(sum(one) for one in every)
    )


def test_nearest_keeps_the_slots_shortens_the_longest_flight_and_lasts_for_the_next_move() -> None:
    fleet = fleet_with(it={"shape": "circle", "rotation_deg": 180.0})
    own, dealt = (ordered(fleet, f"formation it 0 0 1{word}") for word in ("", " nearest"))

    def longest_m(planned: PlannedOrder) -> float:
        return max(
            math.dist(order.position_enu_m or (), fleet.vehicles[name].start_enu_m)
            for name, order in planned.orders.items()
        )

    assert {order.position_enu_m for order in own.orders.values()} == {
        o.position_enu_m for o in dealt.orders.values()
    }
    assert longest_m(dealt) < 0.8 * longest_m(own)
    then = plan_order(
        parse("move all 1 0 1", fleet), fleet, None, held=dealt.held, author="x", now_ns=0
    )
    for name, order in then.orders.items():
        was = dealt.orders[name].position_enu_m
        assert was is not None
        assert order.position_enu_m == pytest.approx((was[0] + 1.0, was[1], was[2]))

    intent = parse("formation it 0 0 1 nearest turned 30", fleet)
    assert isinstance(intent, Formation)
    assert intent.assign == "nearest"
    # written out, an order to all names each of them
    assert parse(str(intent), fleet) == msgspec.structs.replace(intent, is_everybody=False)


def test_ways_home_come_no_nearer_than_the_spots_over_the_root_of_two() -> None:
    """At every share of the way, of straight ways that take the same time."""
    generator = np.random.default_rng(5)
    for count in (2, 5, 12):
        grid = np.array([(1.6 * (k % 4), 1.6 * (k // 4)) for k in range(count)])
        homes = {f"mav{k}": (float(x), float(y), 0.0) for k, (x, y) in enumerate(grid)}
        places = grid[generator.permutation(count)] + generator.uniform(-0.2, 0.2, (count, 2))
        spots = {f"mav{k}": (float(x) + 9.0, float(y), 2.0) for k, (x, y) in enumerate(places)}

        takes = spots_without_crossing(homes, spots)
        assert sorted(takes.values()) == sorted(homes)
        begin = np.array([spots[name][:2] for name in takes])
        end = np.array([homes[taken][:2] for taken in takes.values()])
        least_m = min(_nearest_m(begin), _nearest_m(end)) / math.sqrt(2.0)
        for share in np.linspace(0.0, 1.0, 41):
            assert _nearest_m(begin + share * (end - begin)) >= least_m - 1e-9

    # each at its own would cross
    crossed = {"mav0": (1.6, 9.0, 1.0), "mav1": (0.0, 9.0, 1.0)}
    own = {"mav0": (0.0, 0.0, 0.0), "mav1": (1.6, 0.0, 0.0)}
    assert spots_without_crossing(own, crossed) == {"mav0": "mav1", "mav1": "mav0"}


def _nearest_m(points: Any) -> float:
    """Return the smallest distance of two of some points, (N, 2)."""
    distances_m = np.sqrt(((points[:, None] - points[None]) ** 2).sum(-1))
    return float(distances_m[np.triu_indices(len(points), 1)].min())
