"""Records for viewers, read with mcap's own reader and decoded by the schemas in the file."""

from __future__ import annotations

import contextlib
import json
import math
from collections import defaultdict
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader

pytest.importorskip("mcap_protobuf")

from mcap_protobuf.decoder import DecoderFactory

from groundstation.cli import main
from groundstation.recording.channels import RECORDED
from groundstation.recording.flight_reading import read_flight
from groundstation.recording.law_rows import RecordedLaw
from groundstation.recording.timeline import Timeline
from groundstation.viewers.viewer_record import write_viewer_record
from onboard.bus.schema import TickSample
from onboard.config.fleet import ConfigError
from tests.groundstation.recorded import FLEET, SECOND
from tests.groundstation.report.made_up import (
    APART_M,
    BEGIN_NS,
    head_on,
    poses,
    position,
    rows,
    story,
    write,
)

SCHEMAS = {
    "/tf": "foxglove.FrameTransforms",
    "/scene": "foxglove.SceneUpdate",
    "/scene/static": "foxglove.SceneUpdate",
    "/scene/law": "foxglove.SceneUpdate",
    "/scene/people": "foxglove.SceneUpdate",
    "/positions": "foxglove.PointCloud",
    "/log": "foxglove.Log",
}
PEOPLE = """
[people.anna]
mocap_body = "cap3"
radius_m = 0.5

[people.ben]
"""
SEEN_S = 6.0  # anna is seen for so long
Message = tuple[int, str, Any]  # log time, name of the schema, content


def walk(time_s: float) -> tuple[float, float, float]:
    """Where anna's markers are."""
    return (0.5 * time_s - 2.0, -2.0, 1.7)


def read(path: Path) -> dict[str, list[Message]]:
    """Every message of the file by its topic; those of protobuf decoded by the file's schemas."""
    found: dict[str, list[Message]] = defaultdict(list)
    factory = DecoderFactory()
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            assert schema is not None
            if channel.message_encoding == "protobuf":
                decode = factory.decoder_for("protobuf", schema)
                assert decode is not None
                content = decode(message.data)
            else:
                content = json.loads(message.data)
            found[channel.topic].append((message.log_time, schema.name, content))
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write(
        tmp_path_factory.mktemp("viewers") / "flight",
        [*rows(), *story("mav0"), *poses("cap3", walk, 0.0, SEEN_S)],
        fleet=FLEET.read_text(encoding="utf-8") + PEOPLE,
    )
    (folder / "mission.toml").write_text("schema = 1\n")
    (folder / "verdict.json").write_text('{"passed": true}')
    return folder


@pytest.fixture(scope="module")
def path(folder: Path) -> Path:
    path, _ = write_viewer_record(folder)
    return path


@pytest.fixture(scope="module")
def found(path: Path) -> dict[str, list[Message]]:
    return read(path)


def test_each_channel_has_its_schema_and_every_message_decodes(
    found: dict[str, list[Message]],
) -> None:
    for topic, name in SCHEMAS.items():
        assert {schema for _, schema, _ in found[topic]} == {name}
    assert len(found["/tf"]) == pytest.approx(501, abs=3)
    assert len(found["/scene"]) == pytest.approx(101, abs=2)
    assert len(found["/scene/static"]) == 1


def test_a_transform_is_there_at_or_before_each_message(found: dict[str, list[Message]]) -> None:
    first: dict[str, int] = {}
    for log_time_ns, _, content in found["/tf"]:
        for transform in content.transforms:
            assert transform.parent_frame_id == "fleet"
            first.setdefault(transform.child_frame_id, log_time_ns)
    earliest_ns = min(messages[0][0] for messages in found.values())
    assert first == {"mav0": earliest_ns, "mav1": earliest_ns}


def test_a_vehicle_is_where_the_record_has_it(found: dict[str, list[Message]]) -> None:
    [at_5_s] = [
        content for stamp_ns, _, content in found["/tf"] if stamp_ns == BEGIN_NS + 5 * 10**9
    ]
    mav1 = next(one for one in at_5_s.transforms if one.child_frame_id == "mav1")
    expected = position(1, 5.0)
    assert mav1.translation.x == pytest.approx(expected[0], abs=0.001)
    assert mav1.translation.y == pytest.approx(expected[1], abs=0.001)
    assert mav1.translation.z == pytest.approx(expected[2], abs=0.001)
    entity_ids = {one.id for _, _, content in found["/scene"] for one in content.entities}
    assert entity_ids == {"mav0", "mav1"}


def test_a_person_is_a_cylinder_as_high_as_the_markers_with_the_path_of_the_last_seconds(
    found: dict[str, list[Message]],
) -> None:
    [anna] = _people_at(found, 5.0)  # ben was never seen
    assert anna.id == anna.texts[0].text == "anna"
    [body] = anna.cylinders
    east_m, north_m, head_m = walk(5.0)
    centre = body.pose.position
    assert (centre.x, centre.y) == pytest.approx((east_m, north_m), abs=0.01)
    assert centre.z == pytest.approx(head_m / 2.0, abs=0.01)
    assert (body.size.x, body.size.y) == (1.0, 1.0)
    assert body.size.z == pytest.approx(head_m, abs=0.01)

    [path] = anna.lines
    ends = [(path.points[number].x, path.points[number].y) for number in (0, -1)]
    assert ends[0] == pytest.approx(walk(0.0)[:2], abs=0.11)
    assert ends[1] == pytest.approx(walk(5.0)[:2], abs=0.11)


def test_a_person_who_is_not_seen_is_grey_and_marked_where_he_was_seen_last(
    found: dict[str, list[Message]],
) -> None:
    [seen] = _people_at(found, SEEN_S + 0.8)
    [lost] = _people_at(found, SEEN_S + 1.2)
    assert seen.texts[0].text == "anna"
    assert lost.texts[0].text == "anna, not seen"
    assert lost.cylinders[0].pose.position == seen.cylinders[0].pose.position
    colour = lost.cylinders[0].color
    assert max(colour.r, colour.g, colour.b) - min(colour.r, colour.g, colour.b) < 0.15
    assert colour != seen.cylinders[0].color


def test_a_vehicle_that_is_silent_is_grey_and_marked_where_it_was_last(tmp_path: Path) -> None:
    told = [row for row in rows() if row[2] == "mav0" or row[0] <= BEGIN_NS + 5 * SECOND]
    found = read(write_viewer_record(write(tmp_path, told))[0])

    _, known = _vehicles_at(found, 5.8)
    mav0, silent = _vehicles_at(found, 6.2)
    assert known.texts[0].text == "mav1"
    assert silent.texts[0].text == "mav1, silent"
    assert silent.cylinders[0].pose.position == known.cylinders[0].pose.position
    colour = silent.cylinders[0].color
    assert max(colour.r, colour.g, colour.b) - min(colour.r, colour.g, colour.b) < 0.15
    assert not [*silent.lines, *silent.spheres, *silent.arrows]
    assert mav0.texts[0].text == "mav0"


def test_no_vehicle_is_lost_at_the_end_of_a_record(found: dict[str, list[Message]]) -> None:
    _, _, update = found["/scene"][-1]
    assert [entity.texts[0].text for entity in update.entities] == ["mav0", "mav1"]


def test_a_vehicle_that_tells_no_position_is_not_said_to_be_silent(tmp_path: Path) -> None:
    told = []
    for at_ns, topic, name, message in rows(has_truth=False):
        if isinstance(message, TickSample) and name == "mav1" and at_ns > BEGIN_NS + 5 * SECOND:
            message = msgspec.structs.replace(message, position_enu_m=(math.nan,) * 3)
        told.append((at_ns, topic, name, message))
    found = read(write_viewer_record(write(tmp_path, told))[0])

    _, lost = _vehicles_at(found, 6.2)
    assert lost.texts[0].text == "mav1, no position"


def _vehicles_at(found: dict[str, list[Message]], time_s: float) -> list[Any]:
    """The vehicles' entities at a time of the flight."""
    wanted_ns = BEGIN_NS + round(time_s * SECOND)
    _, _, update = min(found["/scene"], key=lambda one: abs(one[0] - wanted_ns))
    return list(update.entities)


def test_a_flight_without_persons_has_no_topic_of_theirs(tmp_path: Path) -> None:
    found = read(write_viewer_record(write(tmp_path, rows(length_s=1.0)))[0])
    assert "/scene" in found
    assert "/scene/people" not in found


def _people_at(found: dict[str, list[Message]], time_s: float) -> list[Any]:
    """The persons' entities at a time of the flight."""
    wanted_ns = BEGIN_NS + round(time_s * SECOND)
    _, _, update = min(found["/scene/people"], key=lambda one: abs(one[0] - wanted_ns))
    return list(update.entities)


def test_the_half_plane_of_who_is_held_back_stands_before_it(tmp_path: Path) -> None:
    found = read(write_viewer_record(write(tmp_path, head_on()))[0])

    _, _, update = found["/scene/law"][2]
    entities = {one.id: one for one in update.entities}
    assert set(entities) == {"mav0", "mav1"}

    edge, *_ = entities["mav0"].lines
    begin, end = edge.points[0], edge.points[1]
    # the edge lies across the line to mav1, and behind mav0, which has to brake
    assert begin.x == pytest.approx(end.x)
    assert begin.y < 0.0 < end.y or end.y < 0.0 < begin.y
    row = RecordedLaw(read_flight(tmp_path)).row("mav0", 10)
    assert row is not None
    assert begin.x == pytest.approx(-APART_M / 2.0 - 0.25 * row.bound_m_s2, abs=0.001)


def test_the_records_own_messages_are_beside_them_as_they_are(
    folder: Path, found: dict[str, list[Message]]
) -> None:
    with contextlib.closing(Timeline(folder)) as timeline:
        before = timeline.count_messages()

    own = {topic: messages for topic, messages in found.items() if not topic.startswith("/")}
    assert sum(map(len, own.values())) == before
    assert own["tick/mav0"][0][1] == "covey.TickSample"
    assert own["tick/mav0"][0][2]["active_neighbour"] == "mav1"


def test_fleet_mission_and_verdict_are_attached_before_everything(folder: Path, path: Path) -> None:
    with path.open("rb") as stream:
        attached = {one.name: one.data for one in make_reader(stream).iter_attachments()}
    assert set(attached) == {"fleet.toml", "mission.toml", "verdict.json"}
    assert attached["fleet.toml"] == (folder / "fleet.toml").read_bytes()
    begin = path.read_bytes()[:200]
    assert b"fleet.toml" in begin


def test_the_file_is_at_most_twice_as_large(folder: Path, path: Path) -> None:
    assert path.stat().st_size < 2 * (folder / "flight.mcap").stat().st_size


def test_out_may_have_any_name_and_leaves_other_files_alone(tmp_path: Path) -> None:
    folder = write(tmp_path / "flight", rows(length_s=0.2))
    mine = tmp_path / "my.part"
    mine.write_bytes(b"mine")
    for out in (tmp_path / "my.mcap", tmp_path / "other.part"):
        assert write_viewer_record(folder, out)[0] == out
        assert out.stat().st_size > 0
    assert mine.read_bytes() == b"mine"


def test_outdoors_each_vehicle_has_its_fix(tmp_path: Path) -> None:
    fleet = (Path(__file__).parents[3] / "configs" / "fleets" / "px4-sitl.toml").read_text(
        encoding="utf-8"
    )
    folder = write(tmp_path / "flight", rows(length_s=2.0), fleet=fleet)

    found = read(write_viewer_record(folder)[0])

    fixes = [content for _, _, content in found["/fix/mav0"]]
    assert {one.frame_id for one in fixes} == {"fleet"}
    east_m = (fixes[10].longitude - fixes[0].longitude) * 111_195
    assert 0.0 < east_m < 1.0


def test_the_layout_shows_topics_that_are_there(folder: Path) -> None:
    found = read(write_viewer_record(folder)[0])
    text = files("groundstation.viewers").joinpath("layouts/flight.json").read_text("utf-8")
    layout = json.loads(text)

    scene = layout["configById"]["3D!covey"]
    assert scene["followTf"] == "fleet"
    assert set(scene["topics"]) <= set(found)
    assert layout["configById"]["RosOut!covey"]["topicToRender"] in found


def test_the_layout_plots_fields_that_the_file_describes_in_the_colours_of_the_scene(
    path: Path, found: dict[str, list[Message]]
) -> None:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    fields = {
        channel.topic: json.loads(summary.schemas[channel.schema_id].data)["properties"]
        for channel in summary.channels.values()
        if channel.message_encoding == "json"
    }
    _, _, scene = found["/scene"][0]
    colours = {one.id: _hex(one.texts[0].color) for one in scene.entities}
    text = files("groundstation.viewers").joinpath("layouts/flight.json").read_text("utf-8")
    panels = json.loads(text)["configById"]

    for panel in ("Plot!distance", "Plot!law"):
        assert panels[panel]["lichtblickPanelTitle"]
        mav0, mav1, _mav2 = panels[panel]["paths"]
        for name, series in (("mav0", mav0), ("mav1", mav1)):
            topic, field = series["value"].split(".")
            assert fields[topic][field]["type"] == "number"
            kind, _, vehicle = topic.partition("/")
            assert vehicle == name
            assert kind not in RECORDED, "nothing of it comes from a flying fleet"
            assert series["color"] == colours[name]


def _hex(colour: Any) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in (colour.r, colour.g, colour.b))


def test_the_layout_names_each_vehicle_once() -> None:
    # the scene has its name already
    text = files("groundstation.viewers").joinpath("layouts/flight.json").read_text("utf-8")
    scene = json.loads(text)["configById"]["3D!covey"]["scene"]
    assert scene["transforms"]["showLabel"] is False


def test_the_layout_of_foxglove_is_what_its_own_library_writes(folder: Path) -> None:
    pytest.importorskip("foxglove")
    from tests.groundstation.viewers.foxglove_layout import PATH, layout

    text = PATH.read_text(encoding="utf-8")
    assert text == layout(), "write it anew: python -m tests.groundstation.viewers.foxglove_layout"
    topics = set(read(write_viewer_record(folder)[0]))
    for topic in ("/scene", "/scene/static", "/positions", "/log"):
        assert topic in topics
        assert f'"{topic}"' in text


def test_the_command_writes_it_beside_the_record(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["log", "export", str(folder), "--foxglove"]) == 0

    assert capsys.readouterr().out.strip() == str(folder / "flight.foxglove.mcap")


def test_the_command_says_of_a_record_that_it_was_cut_off(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flown = write(tmp_path / "flight", rows(length_s=3.0))
    file = flown / "flight.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])

    assert main(["log", "export", str(flown), "--foxglove"]) == 0

    assert f"covey: {flown}: The record was cut off" in capsys.readouterr().err


def test_neither_a_record_nor_a_file_of_somebody_else_is_overwritten(
    folder: Path, path: Path, tmp_path: Path
) -> None:
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    record = folder / "flight.mcap"
    before = record.read_bytes()
    kept_record = tmp_path / "kept.mcap"
    kept_record.write_bytes(before)

    for out in (notes, record, kept_record):
        with pytest.raises(ConfigError, match="it is not overwritten"):
            write_viewer_record(folder, out)
    assert notes.read_text() == "mine"
    assert record.read_bytes() == before
    assert kept_record.read_bytes() == before
    assert write_viewer_record(folder, path)[0] == path
