"""A flying fleet for viewers: the topics of a record, over the socket that they read."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import math
import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import aiohttp
import msgspec
import pytest

pytest.importorskip("foxglove")
pytest.importorskip("mcap_protobuf")

from mcap.records import Schema
from mcap_protobuf.decoder import DecoderFactory

from groundstation.fleet.state import PERSON_STALE_NS, TELEMETRY_STALE_NS, fold
from groundstation.viewers.live_scene import LiveScene
from groundstation.viewers.live_server import LiveServer
from groundstation.viewers.scene_messages import static_scene
from onboard.bus.schema import MocapPose, MocapPoses, Telemetry
from onboard.config.fleet import ConfigError
from onboard.config.people import Person
from tests.groundstation.console.scenes import SteadyClient, crowd, fly

NOW_NS = 1_700_000_000_000_000_000
AVOIDANCE_THICKNESS = 4.0  # of a line to whom the law avoids


def flying(people: Mapping[str, Person] = MappingProxyType({})) -> SteadyClient:
    fleet = msgspec.structs.replace(crowd(3, "mav{}", 8.0), people=dict(people))
    client = SteadyClient(fleet)
    fly(client, 1.0)
    return client


def scene_of(client: SteadyClient, scene: LiveScene) -> dict[str, Any]:
    return dict(scene.messages(client.state, client.now_ns(), NOW_NS))


def test_a_fleet_has_frames_scene_and_points() -> None:
    client = flying()
    found = scene_of(client, LiveScene(client.fleet))

    assert set(found) == {"/tf", "/scene", "/positions"}
    assert [one.child_frame_id for one in found["/tf"].transforms] == ["mav0", "mav1", "mav2"]
    assert {one.parent_frame_id for one in found["/tf"].transforms} == {"fleet"}
    assert [one.id for one in found["/scene"].entities] == ["mav0", "mav1", "mav2"]
    x, y, _ = struct.unpack_from("<fff", found["/positions"].data)
    view = client.state.vehicles["mav0"]
    assert view.telemetry is not None
    assert (x, y) == pytest.approx(view.telemetry.position_enu_m[:2], abs=0.2)


def test_a_trail_follows() -> None:
    client = flying()
    scene = LiveScene(client.fleet)
    scene_of(client, scene)
    client.clock_ns += 500_000_000
    fly(client, 1.5)
    found = scene_of(client, scene)

    entities = {one.id: one for one in found["/scene"].entities}
    trails = [line for line in entities["mav0"].lines if len(line.points) == 2]
    assert trails


def test_a_disabled_vehicle_is_shown_once_it_is_heard() -> None:
    fleet = crowd(3, "mav{}", 8.0)
    off = msgspec.structs.replace(fleet.vehicles["mav1"], enabled=False)
    client = SteadyClient(msgspec.structs.replace(fleet, vehicles={**fleet.vehicles, "mav1": off}))
    client.hear("mav0")
    scene = LiveScene(client.fleet)
    assert [one.id for one in scene_of(client, scene)["/scene"].entities] == ["mav0"]

    client.hear("mav1")
    entities = scene_of(client, scene)["/scene"].entities
    assert [one.id for one in entities] == ["mav0", "mav1"]


def test_a_vehicle_whose_position_was_never_known_is_left_out() -> None:
    client = SteadyClient(crowd(2, "mav{}", 8.0))
    client.hear("mav0")
    client.hear("mav1", position_enu_m=(math.nan, 0.0, 1.0))
    found = scene_of(client, LiveScene(client.fleet))

    assert [one.id for one in found["/scene"].entities] == ["mav0"]


@pytest.mark.parametrize("is_heard", [True, False])
def test_a_vehicle_that_is_lost_is_grey_and_marked_where_it_was_last(is_heard: bool) -> None:
    client = flying()
    scene = LiveScene(client.fleet)
    _, mav1, _ = scene_of(client, scene)["/scene"].entities
    last_enu_m = mav1.cylinders[0].pose.position

    client.clock_ns += TELEMETRY_STALE_NS + 1
    client.hear("mav0", law_status="saturated", avoids="mav1")
    if is_heard:
        client.hear("mav1", is_position_valid=False)
    found = scene_of(client, scene)

    entities = {one.id: one for one in found["/scene"].entities}
    lost = entities["mav1"]
    assert lost.texts[0].text == ("mav1, no position" if is_heard else "mav1, silent")
    assert not [*lost.lines, *lost.spheres, *lost.arrows]
    assert lost.cylinders[0].pose.position.x == pytest.approx(last_enu_m.x, abs=0.05)
    colour = lost.cylinders[0].color
    assert max(colour.r, colour.g, colour.b) - min(colour.r, colour.g, colour.b) < 0.15
    # no line to where it may no longer be
    assert all(line.thickness < AVOIDANCE_THICKNESS for line in entities["mav0"].lines)
    assert [one.child_frame_id for one in found["/tf"].transforms] == ["mav0"]


@pytest.mark.parametrize(("avoids", "lines"), [("mav1", 1), ("anna", 1), ("", 0)])
def test_a_line_goes_to_whom_the_law_avoids_and_to_no_other_one(avoids: str, lines: int) -> None:
    client = flying({"anna": Person()})
    see(client, (0.0, 2.0, 1.7))
    client.hear("mav0", law_status="saturated", avoids=avoids, nearest_vehicle="mav2")
    found = scene_of(client, LiveScene(client.fleet))

    mav0 = next(one for one in found["/scene"].entities if one.id == "mav0")
    assert len(mav0.lines) == lines_without_avoidance() + lines


def lines_without_avoidance() -> int:
    """Number of lines of a vehicle whose law does nothing."""
    client = flying()
    client.hear("mav0", law_status="inactive")
    found = scene_of(client, LiveScene(client.fleet))
    return len(next(one for one in found["/scene"].entities if one.id == "mav0").lines)


def see(client: SteadyClient, position_enu_m: tuple[float, float, float]) -> None:
    pose = MocapPose(
        body="anna",
        boot_id=1,
        sequence=1,
        stamp_ns=client.now_ns(),
        is_tracked=True,
        position_enu_m=position_enu_m,
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    )
    client.state = fold(client.state, MocapPoses(poses=(pose,)), client.now_ns())


def test_a_person_is_in_the_scene_from_the_first_pose_on_and_marked_while_he_is_not_seen() -> None:
    client = flying({"anna": Person(radius_m=0.5)})
    scene = LiveScene(client.fleet)
    assert not scene_of(client, scene)["/scene/people"].entities

    for east_m in (1.0, 1.5):
        client.clock_ns += 300_000_000
        see(client, (east_m, 2.0, 1.7))
        [anna] = scene_of(client, scene)["/scene/people"].entities
    assert anna.texts[0].text == "anna"
    assert anna.cylinders[0].size.z == pytest.approx(1.7)
    assert [(point.x, point.y) for point in anna.lines[0].points] == [(1.0, 2.0), (1.5, 2.0)]

    client.clock_ns += PERSON_STALE_NS
    [lost] = scene_of(client, scene)["/scene/people"].entities
    assert lost.texts[0].text == "anna, not seen"
    assert lost.cylinders[0].pose == anna.cylinders[0].pose
    assert lost.cylinders[0].color != anna.cylinders[0].color


async def served(server: LiveServer, port: int, topic: str) -> tuple[dict[str, Any], bytes]:
    """What a viewer gets of a topic: the channel as it is advertised, and a message."""
    url = f"ws://127.0.0.1:{port}"
    async with (
        aiohttp.ClientSession() as http,
        http.ws_connect(url, protocols=("foxglove.sdk.v1",)) as socket,
    ):
        channels: dict[str, dict[str, Any]] = {}
        while topic not in channels:
            said = json.loads((await socket.receive(timeout=10.0)).data)
            for channel in said.get("channels", ()):
                channels[channel["topic"]] = channel

        wanted = {"id": 7, "channelId": channels[topic]["id"]}
        await socket.send_json({"op": "subscribe", "subscriptions": [wanted]})
        async with asyncio.timeout(20.0):
            while True:
                put_all(server)
                with contextlib.suppress(TimeoutError):
                    said_data = await socket.receive(timeout=0.2)
                    if said_data.type is aiohttp.WSMsgType.BINARY:
                        data: bytes = said_data.data
                        return channels[topic], data


def put_all(server: LiveServer) -> None:
    client = flying()
    for topic, content in LiveScene(client.fleet).messages(client.state, client.now_ns(), NOW_NS):
        server.put(topic, content, NOW_NS)
    server.put("/scene/static", static_scene(client.fleet, NOW_NS), NOW_NS)
    server.put_json("telemetry/mav0", Telemetry, b'{"vehicle": "mav0"}', NOW_NS)


@pytest.mark.realtime
@pytest.mark.parametrize("topic", ["/tf", "/scene", "/scene/static", "/positions"])
async def test_each_topic_decodes_by_the_schema_that_is_advertised(topic: str) -> None:
    server = LiveServer("test")
    port = server.start("127.0.0.1", 0)
    try:
        put_all(server)
        channel, data = await served(server, port, topic)
    finally:
        server.stop()

    opcode, subscription, stamp_ns = struct.unpack_from("<BIQ", data)
    assert (opcode, subscription, stamp_ns) == (1, 7, NOW_NS)
    schema = Schema(
        id=1,
        name=channel["schemaName"],
        encoding=channel["schemaEncoding"],
        data=base64.b64decode(channel["schema"]),
    )
    decode = DecoderFactory().decoder_for("protobuf", schema)
    assert decode is not None
    content = decode(data[struct.calcsize("<BIQ") :])
    assert len(getattr(content, "transforms", None) or getattr(content, "entities", None) or "x")


@pytest.mark.realtime
async def test_the_fleets_own_messages_go_out_as_they_are() -> None:
    server = LiveServer("test")
    port = server.start("127.0.0.1", 0)
    try:
        put_all(server)
        channel, data = await served(server, port, "telemetry/mav0")
    finally:
        server.stop()
    assert channel["schemaName"] == "covey.Telemetry"
    assert data.endswith(b'{"vehicle": "mav0"}')


@pytest.mark.realtime
async def test_a_port_that_is_taken_is_refused_in_a_sentence() -> None:
    first = LiveServer("test")
    port = first.start("127.0.0.1", 0)
    try:
        with pytest.raises(ConfigError, match="cannot be opened"):
            await asyncio.to_thread(LiveServer("test").start, "127.0.0.1", port)
    finally:
        first.stop()
