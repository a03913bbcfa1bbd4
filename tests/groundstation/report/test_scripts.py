"""The scripts of a report, run where there is something to run them with: node, Chromium."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import msgspec
import numpy as np
import pytest

from groundstation.recording.flight_reading import read_flight
from groundstation.report.flight_page import write_page
from groundstation.report.payload import payload
from groundstation.report.report_page import OWN_SCRIPTS, _own
from groundstation.scene.static_files import SCRIPTS, text_of
from onboard.bus.topics import Topic
from tests.groundstation.px4_logs.made_up_logs import write_flight_with_logs
from tests.groundstation.recorded import SECOND
from tests.groundstation.report.made_up import BEGIN_NS, opened, rows, story, write

NODE = shutil.which("node")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_node = pytest.mark.skipif(NODE is None, reason="there is no node on this computer")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium here")

MARKUP = '<img src=x onerror="document.title = String(7 * 191)">'
FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-sync"
    " --disable-background-networking --disable-component-update --use-gl=angle"
    " --use-angle=swiftshader --enable-unsafe-swiftshader --virtual-time-budget=8000"
)

READ = """
const data = require("fs").readFileSync(process.argv[2]);
Covey.inflated(new Uint8Array(data)).then((bytes) => {
  const flight = Covey.flightOf(bytes);
  console.log(JSON.stringify({
    x: Array.from(flight.curve(0, "x"), (value) => (Number.isNaN(value) ? null : value)),
    missing: Array.from(flight.curve(0, "nothing")).every(Number.isNaN),
    distance: flight.distances(0, 1)[250],
    smallest: flight.smallestDistances()[250],
    between: flight.positionAt(0, 5.01),
    attitude: flight.attitudeAt(0, 5),
    promise: flight.promise_m,
    pairs: ["mav0-mav1", "mav1-mav0", "mav0-mav0", "mav0", "x-y"].map(
      (one) => flight.pairNamed(one),
    ),
  }));
});
"""


def run_node(script: str, *arguments: str) -> str:
    assert NODE is not None
    done = subprocess.run(
        [NODE, "-", *arguments], input=script, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@needs_node
def test_the_page_reads_what_was_packed(tmp_path: Path) -> None:
    folder = write(tmp_path, rows())
    data = payload(read_flight(folder), made_by="test")
    (tmp_path / "data").write_bytes(data)
    _, curves = opened(data)

    found = json.loads(run_node(_own("payload.js") + READ, str(tmp_path / "data")))

    x = np.array([np.nan if value is None else value for value in found["x"]])
    assert np.allclose(x, curves["0/x"], atol=1e-5, equal_nan=True)
    assert found["missing"]
    assert found["distance"] == found["smallest"] == pytest.approx(0.9, abs=0.002)
    assert found["between"] == pytest.approx([0.005, 0.0, 1.0], abs=0.002)
    assert found["attitude"] == pytest.approx([1, 0, 0, 0], abs=1e-3)
    assert found["promise"] == 0.8
    assert found["pairs"] == [[0, 1], [1, 0], None, None, None]


@needs_node
@pytest.mark.parametrize(
    ("limit", "promise_m"), [({"limit_m": 0.9445}, 0.9445), ({"limit_m": None}, 0.94), ({}, 0.94)]
)
def test_the_page_takes_the_promise_of_the_mission_unrounded(
    tmp_path: Path, limit: dict[str, object], promise_m: float
) -> None:
    folder = write(tmp_path, rows(length_s=6.0))
    # a record of an older version has the rounded limit in the sentence, and nothing else
    check = {"name": "min_separation_m", "sentence": "At least 0.94 m between all: ...", **limit}
    (folder / "verdict.json").write_text(json.dumps({"checks": [check]}), encoding="utf-8")
    (tmp_path / "data").write_bytes(payload(read_flight(folder), made_by="test"))

    found = json.loads(run_node(_own("payload.js") + READ, str(tmp_path / "data")))
    assert found["promise"] == promise_m


# the lines of the verdict on the overview: class, sign, sentence
VERDICT = """
const element = (tag, properties, ...children) => ({
  tag, ...properties, style: {}, children: children.flat(Infinity).filter(Boolean),
});
Object.assign(Covey, {
  element,
  table: () => null,
  number: String,
  clock: String,
  vehicleColour: () => "",
  shortened: String,
  smallest: () => 0,
});
const lines = (one) => one.tag === "li" ? [one] : (one.children ?? []).flatMap(lines);
"""
OVERVIEW = """
const data = require("fs").readFileSync(process.argv[2]);
Covey.inflated(new Uint8Array(data)).then((bytes) => {
  const flight = Covey.flightOf(bytes);
  const [verdict] = Covey.views.overview({ flight, address: () => "" });
  console.log(JSON.stringify(lines(verdict).map((line) =>
    [line.className, ...line.children.map((part) => part.children[0])],
  )));
});
"""


@needs_node
@pytest.mark.parametrize(
    ("speed_m_s", "shown"),
    [
        (
            4.217,
            [
                ["warn", "!", "Landed and disarmed: all."],
                ["bad", "✗", "Fell: mav1, and hit the ground with 4.2 m/s, at 14.5 s."],
            ],
        ),
        (0.3, [["good", "✓", "Landed and disarmed: all."]]),
    ],
)
def test_the_verdict_says_how_hard_a_fall_was_and_no_tick_stands_beside_it(
    tmp_path: Path, speed_m_s: float, shown: list[list[str]]
) -> None:
    folder = write(tmp_path, rows(length_s=6.0))
    check = {
        "name": "all_landed",
        "has_come_true": True,
        "sentence": "Landed and disarmed: all.",
    }
    touchdown = {
        "vehicle": "mav1",
        "time_s": 14.46,
        "speed_m_s": speed_m_s,
        "limit_m_s": 1.6,
        "had_thrust": False,
    }
    verdict = {"checks": [check], "touchdowns": [touchdown]}
    (folder / "verdict.json").write_text(json.dumps(verdict), encoding="utf-8")
    (tmp_path / "data").write_bytes(payload(read_flight(folder), made_by="test"))

    script = _own("payload.js") + VERDICT + _own("views.js") + OVERVIEW
    assert json.loads(run_node(script, str(tmp_path / "data"))) == shown


# draws a flight in the air and after the landing, in a scene that only keeps what is drawn
SCENE = """
Object.assign(Covey, {
  Scene: class {
    constructor() {
      this.drawn = [];
      this.camera = {};
      return new Proxy(this, {
        get: (own, name) => own[name] ?? ((...values) => own.drawn.push([name, ...values])),
      });
    }
  },
  Ground: class { draw() {} },
  colour: () => "",
  vehicleColour: () => "",
  rgb: () => [0, 0, 0],
  number: String,
});
const data = require("fs").readFileSync(process.argv[2]);
Covey.inflated(new Uint8Array(data)).then((bytes) => {
  const flight = Covey.flightOf(bytes);
  const distances_m = flight.distances(0, 1);
  console.log(JSON.stringify([5, 9.5].map((time_s) => {
    const picture = new Covey.FlightScene(flight);
    picture.draw(time_s);
    return {
      distance: distances_m[flight.indexAt(time_s)],
      nearest: flight.nearestPair([0, 1].map((one) => flight.positionAt(one, time_s)), time_s),
      rings: picture.scene.drawn.filter(([name]) => name === "ring").length,
      labels: picture.scene.drawn.filter(([name]) => name === "label").map(([, , text]) => text),
    };
  })));
});
"""


@needs_node
@pytest.mark.parametrize("ground_m", [-2.0, 0.0, 0.6])
def test_the_page_knows_who_is_up_wherever_the_ground_is(tmp_path: Path, ground_m: float) -> None:
    folder = write(tmp_path, rows(ground_m=ground_m))
    (tmp_path / "data").write_bytes(payload(read_flight(folder), made_by="test"))

    script = _own("payload.js") + _own("flight_scene.js") + SCENE
    in_flight, landed = json.loads(run_node(script, str(tmp_path / "data")))

    assert in_flight["distance"] == pytest.approx(0.9, abs=0.002)
    assert landed["distance"] is None
    assert in_flight["nearest"]["pair"] == [0, 1]
    assert landed["nearest"] is None
    # in flight each has a ring and a shadow, and there is the distance with its ages
    assert (in_flight["rings"], landed["rings"]) == (4, 0)
    assert in_flight["labels"][2].startswith("0.90 m")
    assert landed["labels"] == ["mav0", "mav1"]


@needs_node
def test_no_script_has_a_mistake_of_syntax() -> None:
    texts = [*map(text_of, SCRIPTS), *map(_own, OWN_SCRIPTS)]

    run_node("\n".join(f"new Function({json.dumps(text)});" for text in texts))


@needs_node
def test_the_camera_shows_a_box_as_a_whole() -> None:
    # corners of the box, seen from where the camera is put: all within the picture
    answer = run_node(
        text_of("camera.js")
        + """
        const camera = new Covey.Camera();
        const found = [];
        for (const aspect of [0.5, 1, 2.2]) {
          camera.fit([-4, -3, 0], [4, 5, 3], aspect);
          const m = camera.matrix(aspect);
          for (const x of [-4, 4]) for (const y of [-3, 5]) for (const z of [0, 3]) {
            const w = m[3] * x + m[7] * y + m[11] * z + m[15];
            found.push((m[0] * x + m[4] * y + m[8] * z + m[12]) / w);
            found.push((m[1] * x + m[5] * y + m[9] * z + m[13]) / w);
          }
        }
        console.log(JSON.stringify(found));
        """
    )

    assert max(abs(value) for value in json.loads(answer)) < 1.0


@needs_node
def test_the_charts_of_distances_show_vehicles_that_keep_far_apart() -> None:
    # the upper end of the axis of each chart, for two vehicles that come to 5 m at most
    answer = run_node(
        """
        globalThis.Covey = { colour: () => "", vehicleColour: () => "", shortened: (name) => name };
        """
        + _own("flight_charts.js")
        + """
        const curve_m = new Float32Array([NaN, 9, 5, 7]);
        const flight = {
          promise_m: 0.8,
          names: ["a", "b"],
          pairs: [[0, 1]],
          smallestDistances: () => curve_m,
          distances: () => curve_m,
        };
        const found = [];
        const charts = { add: (_, { range }) => found.push(range(0.8, 9)[1]) };
        Covey.flightCharts.distances({ flight, charts, marks: [] }, null);
        console.log(JSON.stringify(found));
        """
    )

    highest_m = json.loads(answer)
    assert len(highest_m) == 2
    assert min(highest_m) > 5.0


def dump(page: Path, address: str, tmp_path: Path) -> str:
    """The page as Chromium has it after its scripts."""
    assert CHROMIUM is not None
    words = [CHROMIUM, *FLAGS.split(), f"--user-data-dir={tmp_path / 'browser'}", "--dump-dom"]
    done = subprocess.run(
        [*words, f"{page.as_uri()}{address}"], capture_output=True, text=True, timeout=100
    )
    return done.stdout


@needs_chromium
@pytest.mark.realtime
def test_a_browser_opens_the_pair_and_the_time_that_the_address_names(tmp_path: Path) -> None:
    folder = write(tmp_path / "flight", [*rows(), *story("mav0")])
    page = write_page(folder).path

    shown = dump(page, "#t=5.5&pair=mav1-mav0", tmp_path)

    assert 'data-time="5.500"' in shown
    assert "Age of what each knew of the other" in shown
    assert "closest 0.900 m" in re.sub(r"<[^>]*>", "", shown)


@needs_chromium
@pytest.mark.realtime
def test_the_charge_of_a_flight_is_its_least_and_not_that_after_the_landing(tmp_path: Path) -> None:
    # an emulated battery is full again soon after the landing, a real one recovers a little
    told = []
    for at_ns, topic, name, message in rows():
        if topic is Topic.TELEMETRY:
            second = (at_ns - BEGIN_NS) // SECOND
            battery_frac = {4: 0.62, 9: 1.0}.get(second, 0.8)
            message = msgspec.structs.replace(message, battery_frac=battery_frac)
        told.append((at_ns, topic, name, message))
    page = write_page(write(tmp_path / "flight", told)).path

    shown = re.sub(r"<[^>]*>", "", dump(page, "", tmp_path))

    assert "80 → 62 %" in shown


@needs_chromium
@pytest.mark.realtime
def test_the_scene_offers_px4s_own_track_where_there_is_a_log_of_px4(tmp_path: Path) -> None:
    folder = write_flight_with_logs(tmp_path / "a", length_s=14.0, log_s=9.0, start_s=300.0)
    with_log = dump(write_page(folder).path, "#t=6", tmp_path)
    shutil.rmtree(folder / "px4")
    without_log = dump(write_page(folder).path, "#t=6", tmp_path)

    assert "own log has it" in with_log.partition("<script")[0]
    assert "own log has it" not in without_log.partition("<script")[0]


@needs_chromium
@pytest.mark.realtime
def test_markup_in_names_and_sentences_is_shown_and_not_run(tmp_path: Path) -> None:
    names = (f"a{MARKUP}", "mav1")
    told = [*rows(names), *story(names[0], author=MARKUP, sentence=MARKUP)]
    page = write_page(write(tmp_path / "flight", told)).path

    shown = dump(page, "#view=events", tmp_path)

    assert "<title>flight - Covey</title>" in shown
    assert "&lt;img src=x onerror" in shown
    assert "<img" not in shown
