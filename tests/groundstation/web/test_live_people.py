"""Persons on the live page: what the server says of them, and what the scene draws."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from importlib.resources import files
from typing import Any

import msgspec
import pytest

from groundstation.fleet.state import PERSON_STALE_NS, fold
from groundstation.web.live_messages import fleet_message, state_message
from onboard.bus.schema import MocapPose, MocapPoses
from onboard.config.people import Person
from tests.groundstation.console.scenes import SteadyClient, crowd

NODE = shutil.which("node")
PLACE = (-1.0, -2.0, 1.7)
# A scene that notes what is drawn, with the colours by their names.
SCENE = """
const drawn = [];
globalThis.Covey = {
  Scene: class {
    camera = { fit() {} };
    begin() {}
    ground() {}
    box() {}
    end() {}
    line(begin, end, colour) { drawn.push(["line", begin, end, colour]); }
    ring(middle, radius_m, colour) { drawn.push(["ring", middle, radius_m, colour]); }
    label(place, text) { drawn.push(["label", text]); }
    body() {}
  },
  Ground: class { draw() {} },
  moveByPointer() {},
  colour: (name) => name,
  rgb: (colour) => colour,
  vehicleColour: () => "blue",
};
"""
DRAW = """
const scene = new Covey.LiveScene(null, null, FLEET);
const pictures = STATES.map((state) => {
  drawn.length = 0;
  scene.draw(state, new Set(), null);
  return [...drawn];
});
console.log(JSON.stringify(pictures));
"""
Drawn = list[list[Any]]


def visited() -> SteadyClient:
    people = {"anna": Person(mocap_body="cap3", radius_m=0.5), "ben": Person()}
    return SteadyClient(msgspec.structs.replace(crowd(2, side_m=8.0), people=people))


def see(client: SteadyClient, position_enu_m: tuple[float, float, float]) -> None:
    pose = MocapPose(
        body="cap3",
        boot_id=1,
        sequence=1,
        stamp_ns=client.now_ns(),
        is_tracked=True,
        position_enu_m=position_enu_m,
        quaternion_enu_flu_wxyz=(1.0, 0.0, 0.0, 0.0),
    )
    client.state = fold(client.state, MocapPoses(poses=(pose,)), client.now_ns())


def said(client: SteadyClient) -> dict[str, Any]:
    """The state as a page gets it."""
    now_ns = client.now_ns()
    message = state_message(client.state, client.fleet, alarms=(), control=None, now_ns=now_ns)
    read: dict[str, Any] = json.loads(msgspec.json.encode(message))
    return read


def fleet_said(client: SteadyClient) -> dict[str, Any]:
    read: dict[str, Any] = json.loads(
        msgspec.json.encode(fleet_message(client.fleet, can_order=False))
    )
    return read


def pictures(client: SteadyClient, states: list[dict[str, Any]]) -> list[Drawn]:
    """What the scene draws of each state, beyond the grid."""
    script = (files("groundstation.web") / "live_scene.js").read_text(encoding="utf-8")
    fleet = {**fleet_said(client), "areas": []}
    names = f"const FLEET = {json.dumps(fleet)}; const STATES = {json.dumps(states)};"
    assert NODE is not None
    ended = subprocess.run(
        [NODE, "-"],
        input="\n".join((SCENE, script, names, DRAW)),
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    found: list[Drawn] = json.loads(ended.stdout)
    return found


def test_the_server_says_where_a_person_was_seen_last_and_whether_he_is_seen_now() -> None:
    client = visited()
    assert fleet_said(client)["people"] == [
        {"name": "anna", "radius_m": 0.5},
        {"name": "ben", "radius_m": Person().radius_m},
    ]
    never = {"position_enu_m": None, "is_fresh": False}
    assert said(client)["people"] == [{"name": "anna", **never}, {"name": "ben", **never}]

    see(client, PLACE)
    anna = {"name": "anna", "position_enu_m": list(PLACE), "is_fresh": True}
    assert said(client)["people"] == [anna, {"name": "ben", **never}]
    client.clock_ns += PERSON_STALE_NS
    assert said(client)["people"][0] == {**anna, "is_fresh": False}


def test_a_person_whose_place_is_no_number_has_none() -> None:
    client = visited()
    see(client, (math.nan, 0.0, 1.7))
    assert said(client)["people"][0]["position_enu_m"] is None


@pytest.mark.skipif(NODE is None, reason="there is no node on this computer")
def test_a_person_is_a_circle_that_is_grey_and_marked_while_he_is_not_seen() -> None:
    client = visited()
    see(client, PLACE)
    seen = said(client)
    client.clock_ns += PERSON_STALE_NS
    lost = said(client)

    feet = [-1.0, -2.0, 0]
    for picture, colour, words in zip(
        pictures(client, [seen, lost]), ("warn", "soft"), ("anna", "anna, not seen"), strict=True
    ):
        assert picture == [
            ["ring", feet, 0.5, colour],
            ["ring", list(PLACE), 0.5, colour],
            ["line", feet, list(PLACE), colour],
            ["label", words],
        ], "ben, who was never seen, is nowhere"


@pytest.mark.skipif(NODE is None, reason="there is no node on this computer")
def test_a_line_goes_to_the_person_whom_the_law_avoids() -> None:
    client = visited()
    see(client, PLACE)
    client.hear("v000", law_status="saturated", avoids="anna", position_enu_m=(1.0, 0.0, 1.0))
    [picture] = pictures(client, [said(client)])
    assert ["line", [1, 0, 1], list(PLACE), "warn"] in picture
    assert ["label", "v000 avoids"] in picture
