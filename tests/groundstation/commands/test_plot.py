"""Figures of a flight that was computed here, written with the mcap library's own writer."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import tomllib
import tracemalloc
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import tomli_w
from matplotlib.lines import Line2D
from matplotlib.text import Annotation
from mcap.writer import Writer

from groundstation.cli import main
from groundstation.figures import attitude, avoidance, plan_figure, record_figures, tracking
from groundstation.figures.data import TOPICS, FlightData, PairSeparation, from_samples
from groundstation.figures.style import new_figure, refuse_other_picture, styled, write_figure
from groundstation.recording.reader import Sample
from onboard.config.fleet import ConfigError
from tests.groundstation.recorded import SECOND, read
from tests.groundstation.report.made_up import ahead, rows, write

FIGURES = ("fig2_attitude", "fig4_plan", "fig5_tracking", "fig6_avoidance")
STARTS = ((-1.5, -1.5), (0.0, -1.5), (1.5, -1.5))
GOALS = ((0.0, 2.12), (-0.8, 0.74), (0.8, 0.74))
LENGTH_S = 16.0
LIFTED_S = 0.12  # into the made-up flight, when it has left the ground
SCHEMAS = {"tick": "covey.TickSample", "truth": "covey.Truth", "telemetry": "covey.Telemetry"}


def place(index: int, time_s: float, bend_m: float = 0.0) -> tuple[float, float, float]:
    """Climb, cross over to the goal with a sideways bend, descend."""
    part = min(1.0, max(0.0, (time_s - 3.0) / 8.0))
    smooth = part**3 * (10 - 15 * part + 6 * part**2)
    (x0, y0) = STARTS[index]
    (x1, y1) = GOALS[index]
    bump = bend_m * math.sin(math.pi * smooth) ** 2 * (1, -1, 1)[index]
    height = max(0.0, min(1.0, time_s / 2.0, (LENGTH_S - 1.0 - time_s) / 2.0))
    return (x0 + (x1 - x0) * smooth + bump, y0 + (y1 - y0) * smooth, height)


def tilt(roll: float, pitch: float) -> tuple[float, float, float, float]:
    cr = math.cos(roll / 2)
    sr = math.sin(roll / 2)
    cp = math.cos(pitch / 2)
    sp = math.sin(pitch / 2)
    return (cr * cp, sr * cp, cr * sp, -sr * sp)


def write_flight(folder: Path, *, has_truth: bool = True, ticks: bool = True) -> Path:
    path = folder / "flight.mcap"
    channels: dict[str, int] = {}
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=20_000)
        writer.start()

        def put(channel: str, stamp_ns: int, values: dict[str, object]) -> None:
            if channel not in channels:
                topic, _, _ = channel.partition("/")
                schema = writer.register_schema(SCHEMAS[topic], "jsonschema", b"{}")
                channels[channel] = writer.register_channel(channel, "json", schema)
            writer.add_message(channels[channel], stamp_ns, json.dumps(values).encode(), stamp_ns)

        for step in range(-50, int(LENGTH_S * 50)):
            time_s = step / 50.0
            stamp_ns = 5_000_000_000 + step * 20_000_000
            for index in range(3):
                name = f"mav{index}"
                spot = place(index, time_s, 0.25)
                wanted = place(index, time_s)
                wave = 4.0 * math.sin(1.3 * time_s + index)
                push = 0.8 * math.exp(-((time_s - 7.0) ** 2)) * (1, -1, 1)[index]
                tick: dict[str, object] = {
                    "stamp_ns": stamp_ns, "state": "flying" if time_s >= 0 else "ready",
                    "position_enu_m": spot,
                    "setpoint_position_enu_m": wanted, "thrust_baseline_enu_m_s2": (0.1 * wave,
                    0.08 * wave, 9.8),
                    "thrust_safe_enu_m_s2": (0.1 * wave + push, 0.08 * wave, 9.8),
                    "setpoint_quaternion_enu_flu_wxyz": tilt(math.radians(wave),
                    math.radians(-wave / 2)),
                    "attitude_quaternion_enu_flu_wxyz": tilt(math.radians(0.9 * wave),
                    math.radians(-0.4 * wave)),
                }  # fmt: skip
                if step == 100:
                    # how a number that is none looks in JSON
                    tick["position_enu_m"] = (None, 0.0, 1.0)
                    tick["thrust_safe_enu_m_s2"] = "garbage"
                if ticks:
                    put(f"tick/{name}", stamp_ns, tick)
                if has_truth:
                    put(
                        f"truth/{name}",
                        stamp_ns,
                        {"position_enu_m": spot, "velocity_enu_m_s": (0.0, 0.0, 0.0)},
                    )
                if step % 5 == 0:
                    goal = (*GOALS[index], 1.0)
                    told: dict[str, object] = {
                        "state": "flying",
                        "order_kind": "move" if time_s > 3 else "",
                        "goal_position_enu_m": goal,
                    }
                    put(f"telemetry/{name}", stamp_ns, told)
        writer.finish()
    return path


def flight_of(folder: Path) -> FlightData:
    flight = from_samples(read(folder, TOPICS), title="test", safety_distance_m=0.8)
    assert flight is not None
    return flight


def test_all_figures_are_drawn_as_png_and_svg(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_flight(tmp_path)
    assert main(["plot", str(tmp_path)]) == 0
    for name in FIGURES:
        assert (tmp_path / "figures" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (tmp_path / "figures" / f"{name}.svg").read_text()
    assert len(capsys.readouterr().out.splitlines()) == 8


def test_seconds_count_from_the_first_message_of_the_record_as_in_verdict_and_replay(
    tmp_path: Path,
) -> None:
    write_flight(tmp_path)
    own = flight_of(tmp_path)
    first_ns = min(sample.stamp_ns for sample in read(tmp_path, TOPICS))
    recorded = from_samples(
        read(tmp_path, TOPICS),
        title="test",
        safety_distance_m=0.8,
        record_begin_ns=first_ns - 2_500_000_000,
    )
    assert recorded is not None
    assert recorded.take_off_s == pytest.approx(own.take_off_s + 2.5)


def test_vehicles_of_an_older_record_with_clocks_of_their_own_are_drawn_at_one_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stamps_ns: dict[str, int] = {}

    def first_stamps(samples: Iterable[Sample], **_settings: object) -> None:
        for sample in samples:
            stamps_ns.setdefault(sample.channel, sample.stamp_ns)

    monkeypatch.setattr(record_figures, "from_samples", first_stamps)
    folder = write(tmp_path / "flight", ahead(rows(length_s=1.0), "mav1", 2400 * SECOND))
    with pytest.raises(ConfigError, match="nothing to draw"):
        record_figures.draw_record(folder)
    assert stamps_ns["tick/mav1"] == pytest.approx(stamps_ns["tick/mav0"], abs=0.1 * SECOND)


def test_the_arrays_are_what_was_flown(tmp_path: Path) -> None:
    write_flight(tmp_path)
    flight = flight_of(tmp_path)
    assert [track.name for track in flight.tracks] == ["mav0", "mav1", "mav2"]
    track = flight.tracks[1]
    assert track.is_truth
    assert flight.source == "ground truth"
    at = int(np.argmin(np.abs(track.time_s - 5.0)))
    np.testing.assert_allclose(track.time_s[at], 5.0, atol=1e-9)
    np.testing.assert_allclose(track.position_enu_m[at], place(1, 5.0 + LIFTED_S, 0.25), atol=1e-9)
    wave_deg = 4.0 * math.sin(1.3 * (5.0 + LIFTED_S) + 1)
    np.testing.assert_allclose(track.commanded_deg[at], [wave_deg, -wave_deg / 2], atol=1e-9)
    np.testing.assert_allclose(track.flown_deg[at], [0.9 * wave_deg, -0.4 * wave_deg], atol=1e-9)
    np.testing.assert_allclose(track.slots_enu_m, [[*GOALS[1], 1.0]])
    assert np.isnan(track.thrust_safe_enu_m_s2).any(axis=-1).sum() == 1


def test_distances_are_horizontal_and_only_counted_in_flight(tmp_path: Path) -> None:
    write_flight(tmp_path)
    flight = flight_of(tmp_path)
    pair = flight.pairs[0]
    assert (pair.first, pair.second) == ("mav0", "mav1")
    assert np.isnan(pair.distance_m[flight.grid_s < 0.0]).all()
    times = flight.grid_s[(flight.grid_s > 1.0) & (flight.grid_s < 13.0)]
    wanted = [math.dist(place(0, t, 0.25)[:2], place(1, t, 0.25)[:2]) for t in times + LIFTED_S]
    found = pair.distance_m[(flight.grid_s > 1.0) & (flight.grid_s < 13.0)]
    np.testing.assert_allclose(found, wanted, atol=2e-3)
    closest = flight.closest()
    assert closest is not None
    least = min(float(np.nanmin(other.distance_m)) for other in flight.pairs)
    assert closest[0].distance_m[closest[1]] == least


def test_a_vehicle_whose_agent_did_not_run_is_drawn_by_its_truth(tmp_path: Path) -> None:
    write_flight(tmp_path)
    samples = [sample for sample in read(tmp_path, TOPICS) if sample.channel != "tick/mav0"]
    flight = from_samples(samples, title="test", safety_distance_m=0.8)
    assert flight is not None
    whole = flight_of(tmp_path)
    assert [track.name for track in flight.tracks] == ["mav0", "mav1", "mav2"]
    for pair, whole_pair in zip(flight.pairs, whole.pairs, strict=True):
        np.testing.assert_array_equal(pair.distance_m, whole_pair.distance_m)
    with styled():
        for module in (attitude, avoidance, plan_figure, tracking):
            module.draw(flight)


@pytest.mark.parametrize("has_truth", [True, False])
@pytest.mark.parametrize("ground_m", [-3.0, 0.0, 0.5])
def test_distances_count_above_the_ground_wherever_it_is(ground_m: float, has_truth: bool) -> None:
    samples = []
    for step in range(100):
        climbed_m = max(0.0, 0.02 * (step - 50))
        for name, x_m in (("mav0", 0.0), ("mav1", 0.5 + climbed_m)):
            values = {"position_enu_m": [x_m, 0.0, ground_m + climbed_m]}
            samples.append(Sample(f"tick/{name}", step * SECOND // 50, values))
            if has_truth:
                told = {**values, "is_on_ground": climbed_m == 0.0}
                samples.append(Sample(f"truth/{name}", step * SECOND // 50, told))

    flight = from_samples(samples, title="test", safety_distance_m=0.8)
    assert flight is not None
    (pair,) = flight.pairs
    assert np.isnan(pair.distance_m[flight.grid_s < -0.1]).all()
    assert np.isfinite(pair.distance_m[flight.grid_s > 0.01]).all()
    closest = flight.closest()
    assert closest is not None
    assert closest[0].distance_m[closest[1]] == pytest.approx(0.55, abs=0.035)


@pytest.mark.parametrize("has_truth", [True, False])
def test_no_line_crosses_a_gap_of_a_record_and_no_distance_in_it_is_made_up(
    has_truth: bool,
) -> None:
    samples = []
    for step in range(500):
        time_s = 0.02 * step
        # mav1 flies around mav0, and is not heard on the other half of its circle
        angle = 2.0 * math.pi * time_s / 10.0
        places = {"mav0": [0.0, 0.0, 1.0], "mav1": [math.cos(angle), math.sin(angle), 1.0]}
        for name, place in places.items():
            if name == "mav1" and 2.5 < time_s < 7.5:
                continue
            values = {
                "position_enu_m": place,
                "setpoint_position_enu_m": place,
                "state": "flying",
                "is_on_ground": False,
            }
            samples.append(Sample(f"tick/{name}", step * SECOND // 50, values))
            if has_truth:
                samples.append(Sample(f"truth/{name}", step * SECOND // 50, values))

    flight = from_samples(samples, title="test", safety_distance_m=0.8)
    assert flight is not None
    (pair,) = flight.pairs
    assert np.nanmin(pair.distance_m) == pytest.approx(1.0, abs=0.01)
    in_gap = (flight.grid_s > 2.53) & (flight.grid_s < 7.47)
    assert np.isnan(pair.distance_m[in_gap]).all()
    is_heard = (flight.grid_s < 2.48) | (flight.grid_s > 7.52)
    assert np.isfinite(pair.distance_m[is_heard]).all()

    _, track = flight.tracks
    for times_s, drawn in (
        (track.path_time_s, track.path_enu_m),
        (track.time_s, track.setpoint_position_enu_m),
    ):
        (at,) = np.flatnonzero((times_s > 2.5) & (times_s < 7.5))
        assert np.isnan(drawn[at]).all()


def test_time_marks_of_a_vehicle_that_is_not_known_at_first_have_their_times(
    tmp_path: Path,
) -> None:
    write_flight(tmp_path)
    flight = flight_of(tmp_path)
    track = flight.tracks[0]
    late = track.path_time_s > 1.0
    track = dataclasses.replace(
        track, path_time_s=track.path_time_s[late], path_enu_m=track.path_enu_m[late]
    )
    ax = new_figure(4.0, 4.0, "marks").subplots()
    plan_figure._draw_time_marks(ax, track, np.array([0.0, 4.0, 8.0]), "black")
    assert [text.get_text() for text in ax.texts] == ["4", "8"]


def test_distances_of_a_record_that_begins_in_flight_count() -> None:
    # mav0 lands beside mav1, which stands
    samples = []
    for step in range(50):
        for name, x_m, height_m in (("mav0", 0.0, 1.0 - step / 50), ("mav1", 0.5, 0.0)):
            position_enu_m = [x_m, 0.0, height_m]
            stamp_ns = step * SECOND // 50
            samples.append(Sample(f"tick/{name}", stamp_ns, {"position_enu_m": position_enu_m}))
            told = {"state": "landing", "is_airborne": height_m > 0.0}
            samples.append(Sample(f"telemetry/{name}", stamp_ns, told))

    flight = from_samples(samples, title="test", safety_distance_m=0.8)
    assert flight is not None
    assert np.nanmin(flight.pairs[0].distance_m) == pytest.approx(0.5)
    assert flight.take_off_s == 0.0


def test_a_vehicle_that_a_person_carries_does_not_fly() -> None:
    # mav0 is carried past mav1, and then takes off far from it
    samples = []
    for step in range(200):
        is_flying = step >= 100
        mav0_enu_m = [3.0, 0.0, 0.01 * (step - 100)] if is_flying else [0.03 * step, 0.0, 0.5]
        if step == 0:
            mav0_enu_m = [0.0, 0.0, 0.0]
        stamp_ns = step * SECOND // 50
        for name, position_enu_m, is_airborne in (
            ("mav0", mav0_enu_m, is_flying),
            ("mav1", [0.5, 0.0, 0.0], False),
        ):
            samples.append(Sample(f"tick/{name}", stamp_ns, {"position_enu_m": position_enu_m}))
            samples.append(Sample(f"telemetry/{name}", stamp_ns, {"is_airborne": is_airborne}))

    flight = from_samples(samples, title="test", safety_distance_m=0.8)
    assert flight is not None
    assert np.nanmin(flight.pairs[0].distance_m) == pytest.approx(2.5)
    assert flight.take_off_s == pytest.approx(2.12)


def test_time_counts_from_when_the_first_leaves_the_ground_and_not_from_its_motors_start(
    tmp_path: Path,
) -> None:
    write_flight(tmp_path)
    flight = flight_of(tmp_path)
    for track in flight.tracks:
        height_m = np.interp(0.0, track.path_time_s, track.path_enu_m[:, 2])
        assert 0.04 < height_m < 0.08
    assert flight.grid_s[0] == pytest.approx(-1.0)
    # and says when that was by the clock of replay and verdict
    assert flight.take_off_s == pytest.approx((50 / 50) + LIFTED_S)
    assert f"at {flight.take_off_s:.1f} s of the record" in flight.title


def test_figures_of_a_record_in_which_nobody_takes_off_name_no_take_off() -> None:
    samples = []
    for step in range(20, 120):
        for name, x_m in (("mav0", 0.0), ("mav1", 1.0)):
            stamp_ns = step * SECOND // 50
            samples.append(Sample(f"tick/{name}", stamp_ns, {"position_enu_m": [x_m, 0.0, 0.0]}))
            samples.append(Sample(f"telemetry/{name}", stamp_ns, {"is_airborne": False}))

    flight = from_samples(samples, title="test", safety_distance_m=0.8, record_begin_ns=0)

    assert flight is not None
    assert flight.title == "test (nobody took off)"
    assert flight.time_label == "time in the record [s]"
    assert (flight.take_off_s, flight.grid_s[0]) == (0.0, pytest.approx(0.4))


@pytest.mark.long
def test_without_truth_the_estimates_are_drawn_and_figures_go_where_out_says(
    tmp_path: Path,
) -> None:
    write_flight(tmp_path, has_truth=False)
    assert flight_of(tmp_path).source == "the vehicles' estimates"
    assert main(["plot", str(tmp_path / "flight.mcap"), "--out", str(tmp_path / "a" / "b")]) == 0
    assert len(list((tmp_path / "a" / "b").iterdir())) == 8
    assert not (tmp_path / "figures").exists()


def test_a_picture_of_somebody_else_is_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    photo = out / "fig4_plan.png"
    photo.write_bytes(b"\x89PNG, a photo")
    assert main(["plot", str(tmp_path), "--out", str(out)]) == 2
    refusal = f"{photo}: this file is there already and is no figure of Matplotlib"
    assert refusal in capsys.readouterr().err
    assert photo.read_bytes() == b"\x89PNG, a photo"
    assert list(out.iterdir()) == [photo]


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_a_figure_may_be_replaced_by_a_newer_one(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"figure{suffix}"
    for _ in range(2):
        refuse_other_picture(path, option="--out")
        with styled():
            write_figure(new_figure(2.0, 2.0, "test"), path)
    refuse_other_picture(path, option="--out")
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_record_is_a_sentence_and_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["plot", str(tmp_path / "nowhere")]) == 2
    told = capsys.readouterr().err
    assert told.startswith("covey: ")
    assert "Give the folder of a recorded flight." in told


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "this is no MCAP file"),
        (b"not an mcap file at all", "this is no MCAP file"),
        (b"\x89MCAP0\r\n", "nothing of a flight can be read"),
    ],
)
def test_a_record_without_a_flight_is_a_sentence_and_status_2(
    tmp_path: Path, content: bytes, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "flight.mcap").write_bytes(content)
    assert main(["plot", str(tmp_path)]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "figures").exists()


def test_a_record_without_ticks_is_a_sentence_and_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_flight(tmp_path, ticks=False)
    assert main(["plot", str(tmp_path)]) == 2
    assert "nothing to draw" in capsys.readouterr().err


@pytest.mark.long
def test_a_record_that_breaks_off_is_drawn_as_far_as_it_goes_and_said_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_flight(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])
    assert main(["plot", str(tmp_path)]) == 0
    assert "The record was cut off" in capsys.readouterr().err
    assert (tmp_path / "figures" / "fig4_plan.png").exists()


def test_damage_in_the_middle_of_a_record_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(record_figures, "_FIGURES", {})
    path = write_flight(tmp_path)
    assert main(["plot", str(tmp_path)]) == 0
    said = capsys.readouterr().err
    assert "damaged" not in said
    assert "the paper's safety distance of 0.80 m" in said

    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 40] = bytes(40)
    path.write_bytes(data)
    assert main(["plot", str(tmp_path)]) == 0
    assert "A piece of the record is damaged" in capsys.readouterr().err


def test_the_fleet_s_distance_is_drawn_though_law_and_keys_are_on_another_computer(
    tmp_path: Path,
) -> None:
    fleet = tomllib.loads(Path("configs/fleets/paper.toml").read_text())
    fleet["fleet"]["safety_distance_m"] = 0.81
    fleet["fleet"]["keys"] = "/another/computer/keys"
    fleet["law"] = {"name": "mine:law", "folder": "/another/computer"}
    (tmp_path / "fleet.toml").write_text(tomli_w.dumps(fleet))

    notes: list[str] = []
    assert record_figures._limits(tmp_path, notes)["safety_distance_m"] == 0.81
    assert notes == []


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "there is no fleet.toml beside the record."),
        ("[fleet]\nsafety_distance_m = 0.9\n", "fleet.toml"),
        ("[fleet]\nsafety_distance_m = 'far'\n[vehicles.mav0]\n", "fleet.toml"),
    ],
)
def test_figures_without_a_fleet_file_say_whose_distance_they_show(
    text: str | None, reason: str, tmp_path: Path
) -> None:
    if text is not None:
        (tmp_path / "fleet.toml").write_text(text)
    (tmp_path / "mission.toml").write_text("schema = 1\n")
    notes: list[str] = []
    assert record_figures._limits(tmp_path, notes)["safety_distance_m"] == 0.8
    (note,) = notes
    assert note.startswith("the figures show the paper's safety distance of 0.80 m")
    assert reason in note


def _texts_of_distances(flight: FlightData) -> tuple[list[Line2D], list[Annotation]]:
    """Return lines and texts of the plot of the distances, as it is drawn for three vehicles."""
    with styled():
        figure = new_figure(11.1, 9.2, "distances")
        grid = figure.add_gridspec(3, 1, height_ratios=(1.0, 1.0, 1.5))
        ax = figure.add_subplot(grid[2, :])
        ax.set_xlim(flight.axis_s)
        avoidance._draw_distances(ax, flight)
        figure.canvas.draw()
    return list(ax.lines), list(ax.texts)


@pytest.mark.parametrize(
    ("falling", "high"),
    [
        (
            ([3.0, 6.6, 8.0, 10.0], [1.5, 0.81, 0.81, 1.6]),
            ([3.0, 8.3, 10.0], [3.0, 0.98, 1.6]),
        ),
        # a name would stand where the number of the smallest distance does
        (
            ([3.0, 6.0, 10.8, 11.5, 15.0], [1.5, 0.82, 0.79, 0.8, 1.55]),
            ([3.0, 6.5, 9.0, 9.8, 11.0, 15.0], [3.0, 1.7, 0.9, 0.85, 1.2, 1.55]),
        ),
    ],
)
def test_no_line_and_no_other_text_crosses_the_name_of_a_pair(
    tmp_path: Path, falling: tuple[list[float], list[float]], high: tuple[list[float], list[float]]
) -> None:
    write_flight(tmp_path)
    grid_s = np.arange(-1.0, 27.0, 0.02)
    rising_m = np.interp(grid_s, [6.0, 8.0, 10.0], [1.5, 1.8, 1.6])
    pairs = (
        PairSeparation("mav0", "mav1", np.interp(grid_s, *falling)),
        PairSeparation("mav1", "mav2", rising_m),
        PairSeparation("mav0", "mav2", np.interp(grid_s, *high)),
    )
    lines, texts = _texts_of_distances(
        dataclasses.replace(flight_of(tmp_path), grid_s=grid_s, pairs=pairs)
    )

    assert len(texts) == 5  # with the limit's, and the number of the smallest distance
    boxes = [text.get_window_extent() for text in texts]
    for index, box in enumerate(boxes):
        assert not box.count_overlaps(boxes[:index]), texts[index].get_text()
        if "–" in texts[index].get_text():
            for line in lines:
                assert not box.count_contains(line.get_transform().transform(line.get_xydata()))


@pytest.mark.parametrize(
    ("field", "module", "rare", "most", "unit"),
    [
        ("thrust_baseline_enu_m_s2", avoidance, 4.3, 15.0, "m/s²"),
        ("commanded_deg", attitude, 35.0, 60.0, "deg"),
    ],
)
def test_what_is_rare_in_a_long_flight_is_within_the_axis_and_what_is_beyond_it_is_said(
    tmp_path: Path, field: str, module: ModuleType, rare: float, most: float, unit: str
) -> None:
    write_flight(tmp_path)
    flight = flight_of(tmp_path)

    def drawn(largest: float) -> tuple[float, str]:
        """Return the end of the axis, and the title, of a flight with such a value."""
        track = flight.tracks[1]
        values = getattr(track, field).copy()
        values[100, 0] = largest
        changed = dataclasses.replace(track, **{field: values})
        tracks = (flight.tracks[0], changed, flight.tracks[2])
        with styled():
            figure = module.draw(dataclasses.replace(flight, tracks=tracks))
        return figure.axes[0].get_ylim()[1], figure._suptitle.get_text().replace("\n", " ")

    end, title = drawn(rare)
    assert rare < end < 1.2 * rare
    assert "largest value" not in title

    end, title = drawn(170.0)
    assert end == most
    assert title.endswith(f"; the axes end below the largest value, 170.0 {unit}")


@pytest.mark.parametrize("closest_s", [0.6, 2.0, 8.0, 14.0, 15.3])
@pytest.mark.parametrize("closest_m", [0.75, 0.81, 0.97, 1.1])
def test_the_number_of_the_smallest_distance_covers_no_other_text(
    tmp_path: Path, closest_s: float, closest_m: float
) -> None:
    write_flight(tmp_path)
    flight = flight_of(tmp_path)
    near_m = np.interp(np.abs(flight.grid_s - closest_s), [0.0, 1.0], [closest_m, 1.6])
    far_m = np.full(len(near_m), 3.0)
    pairs = (PairSeparation("mav0", "mav1", near_m), PairSeparation("mav0", "mav2", far_m))

    _, texts = _texts_of_distances(dataclasses.replace(flight, pairs=pairs))

    (number,) = [text for text in texts if text.get_text() == f"{closest_m:.2f} m"]
    others = [text for text in texts if text is not number]
    assert any("safety distance" in text.get_text() for text in others)
    box = number.get_window_extent()
    assert number.axes is not None
    assert number.axes.bbox.x0 <= box.x0 < box.x1 <= number.axes.bbox.x1
    assert not box.count_overlaps([text.get_window_extent() for text in others])


def test_the_nearest_neighbour_of_a_vehicle_that_stands_does_not_stretch_the_distances() -> None:
    # of six in a row, 1.5 m apart, only the first one flies at first
    samples = []
    for step in range(200):
        for index in range(6):
            is_up = step > (20 if index == 0 else 100)
            values = {"position_enu_m": [1.5 * index, 0.0, float(is_up)], "is_on_ground": not is_up}
            for topic in ("tick", "truth"):
                samples.append(Sample(f"{topic}/mav{index}", step * SECOND // 50, values))
    flight = from_samples(samples, title="six", safety_distance_m=0.8)
    assert flight is not None
    assert len(flight.pairs) > avoidance.MAX_PAIRS

    with styled():
        ax = avoidance.draw(flight).axes[-1]
    drawn_m = np.concatenate([line.get_ydata() for line in ax.lines])
    assert np.nanmax(drawn_m) == pytest.approx(1.5)
    lines_m = {line.get_label(): np.asarray(line.get_ydata()) for line in ax.lines}
    assert np.isfinite(lines_m["mav0"][flight.grid_s > 0.1]).all()
    assert "to the nearest neighbour while the vehicle flies" in ax.get_title(loc="left")


@pytest.mark.long
def test_a_large_fleet_is_in_the_order_of_its_numbers_and_on_a_page(tmp_path: Path) -> None:
    write_flight(tmp_path)
    samples = list(read(tmp_path, TOPICS))
    twelve = [
        dataclasses.replace(sample, channel=f"{sample.topic}/mav{number}")
        for number in range(12)
        for sample in samples
        if sample.name == f"mav{number % 3}"
    ]
    flight = from_samples(twelve, title="twelve", safety_distance_m=0.8)
    assert flight is not None
    assert [track.name for track in flight.tracks] == [f"mav{number}" for number in range(12)]

    with styled():
        for module in (attitude, avoidance, plan_figure, tracking):
            figure = module.draw(flight)
            width_in, height_in = figure.get_size_inches()
            assert width_in < 20.0, module.__name__
            assert height_in < 24.0, module.__name__
            titles = [ax.get_title(loc="left").split(" ")[0] for ax in figure.axes]
            if module is not plan_figure:
                assert {f"mav{number}" for number in range(12)} <= set(titles)

    paths = [
        line for line in plan_figure.draw(flight).axes[0].lines if line.get_label()[:3] == "mav"
    ]
    looks = {(line.get_color(), str(line.get_linestyle())) for line in paths}
    assert len(looks) == len(paths) == 12


@pytest.mark.parametrize("vehicles", [1, 2])
def test_the_titles_of_a_small_fleet_are_within_its_figures(vehicles: int) -> None:
    samples = [
        Sample(
            f"tick/mav{index}", step * SECOND // 50, {"position_enu_m": [index, 0.0, 0.1 * step]}
        )
        for step in range(20)
        for index in range(vehicles)
    ]
    flight = from_samples(samples, title="20260101-120000", safety_distance_m=0.8)
    assert flight is not None

    with styled():
        for module in (attitude, avoidance, plan_figure, tracking):
            figure = module.draw(flight)
            figure.draw_without_rendering()
            titles = [text for ax in figure.axes for text in (ax.title, ax._left_title)]
            for text in (figure._suptitle, *titles):
                assert text.get_window_extent().x1 <= figure.bbox.x1, text.get_text()


def test_many_orders_to_one_slot_are_a_short_text_in_the_plan(tmp_path: Path) -> None:
    write_flight(tmp_path)
    flight = from_samples(read(tmp_path, TOPICS), title="to and fro", safety_distance_m=0.8)
    assert flight is not None
    to_and_fro_m = np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]] * 126)
    track = dataclasses.replace(flight.tracks[0], slots_enu_m=to_and_fro_m)
    flight = dataclasses.replace(flight, tracks=(track, *flight.tracks[1:]))

    with styled():
        figure = plan_figure.draw(flight)
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert "1, 3, 5, … 251 (126 orders)" in texts
    assert "2, 4, 6, … 252 (126 orders)" in texts


def test_the_numbers_of_two_slots_are_not_written_over_each_other(tmp_path: Path) -> None:
    write_flight(tmp_path)
    flight = from_samples(read(tmp_path, TOPICS), title="to and fro", safety_distance_m=0.8)
    assert flight is not None
    tracks = [
        dataclasses.replace(
            track, slots_enu_m=np.array([[*goal_m, 1.0], [goal_m[0], -0.5, 1.0]] * 126)
        )
        for track, goal_m in zip(flight.tracks, GOALS, strict=True)
    ]
    flight = dataclasses.replace(flight, tracks=tuple(tracks))

    with styled():
        figure = plan_figure.draw(flight)
        figure.draw_without_rendering()
        texts = [text for text in figure.axes[0].texts if "orders" in text.get_text()]
        boxes = [text.get_window_extent() for text in texts]
    assert len(boxes) == 6
    for first, second in itertools.combinations(boxes, 2):
        assert not first.overlaps(second)


def test_a_long_record_is_not_kept_whole_in_memory() -> None:
    text = json.dumps({"position_enu_m": [1.0, 2.0, 3.0], "others": [0.5] * 50})

    def samples() -> Iterator[Sample]:
        for step in range(5000):
            yield Sample("tick/mav0", step * SECOND // 50, json.loads(text))

    tracemalloc.start()
    try:
        flight = from_samples(samples(), title="long", safety_distance_m=0.8)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert flight is not None
    assert len(flight.tracks[0].time_s) == 5000
    assert peak_bytes < 4_000_000
