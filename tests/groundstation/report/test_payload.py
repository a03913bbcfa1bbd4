from __future__ import annotations

from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import msgspec
import numpy as np
import pytest

from groundstation.recording.flight_reading import read_flight
from groundstation.report import payload as payload_module
from groundstation.report.payload import FIX_NUMBERS, payload
from onboard.bus.schema import Event, Severity, Telemetry, TickSample, Truth
from onboard.bus.topics import Topic
from onboard.corrections.fix import FIX_WORDS
from tests.groundstation.recorded import SECOND
from tests.groundstation.report.made_up import BEGIN_NS, Row, opened, position, rows, story, write


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write(tmp_path / "flight", [*rows(), *story("mav0")])


def test_positions_of_the_page_are_those_of_the_record(folder: Path) -> None:
    header, curves = opened(payload(read_flight(folder), made_by="test"))

    times_s = header["begin_s"] + header["step_s"] * np.arange(header["count"])
    for vehicle in (0, 1):
        expected = np.array([position(vehicle, time_s) for time_s in times_s])
        found = np.stack([curves[f"{vehicle}/{axis}"] for axis in "xyz"], -1)
        is_known = np.isfinite(found).all(-1)
        assert is_known.sum() > 490
        assert np.abs(found - expected)[is_known].max() < 0.002


def test_the_smallest_distance_is_found_with_its_time(folder: Path) -> None:
    header, _ = opened(payload(read_flight(folder), made_by="test"))

    [[first, second, distance_m, time_s]] = header["pairs"]
    assert (first, second) == (0, 1)
    assert distance_m == pytest.approx(0.9, abs=0.001)
    assert time_s == pytest.approx(5.0, abs=0.05)


def test_the_page_has_the_smallest_distance_unrounded_so_that_it_rounds_as_the_verdict(
    tmp_path: Path,
) -> None:
    # 1.4335 is a little less in binary, so it would be shown as 1.433 m
    distance_m = 1.43353
    told: list[Row] = []
    for at_ns, topic, name, message in rows():
        if isinstance(message, Truth):
            _, _, height_m = message.position_enu_m
            place = (distance_m * (name == "mav1"), 0.0, height_m)
            message = msgspec.structs.replace(message, position_enu_m=place)
        told.append((at_ns, topic, name, message))

    header, _ = opened(payload(read_flight(write(tmp_path, told)), made_by="test"))
    [[_, _, shown_m, _]] = header["pairs"]
    assert f"{shown_m:.3f}" == f"{distance_m:.3f}" == "1.434"


def test_distances_of_a_record_that_begins_in_flight_count(tmp_path: Path) -> None:
    told = [row for row in rows(has_truth=False) if 3 * SECOND <= row[0] - BEGIN_NS <= 7 * SECOND]
    header, curves = opened(payload(read_flight(write(tmp_path, told)), made_by="test"))

    [[_, _, distance_m, _]] = header["pairs"]
    assert distance_m == pytest.approx(0.9, abs=0.001)
    assert np.nanmin(curves["0/is_up"]) == 1.0


@pytest.mark.parametrize(
    ("state", "is_airborne", "distance_m"), [("landing", True, 0.9), ("landed", False, None)]
)
def test_without_truth_the_telemetry_says_who_flies_also_in_a_landing_and_when_carried(
    tmp_path: Path, *, state: str, is_airborne: bool, distance_m: float | None
) -> None:
    # mav0 sinks from the first row on, or a person lifts it; mav1 stands
    told: list[Row] = []
    for at_ns, topic, name, message in rows(has_truth=False):
        time_s = (at_ns - BEGIN_NS) / SECOND
        x_m, y_m, _ = position(int(name == "mav1"), time_s)
        place = (x_m, y_m, 0.0)
        if name == "mav0":
            place = (x_m, y_m, 1.0 - 0.1 * time_s if is_airborne else 0.1 * time_s)
        changes: dict[str, object] = {"position_enu_m": place, "state": "ready"}
        if isinstance(message, Telemetry):
            changes["is_airborne"] = is_airborne and name == "mav0"
        if name == "mav0":
            changes["state"] = state
        message = msgspec.structs.replace(message, **changes)
        told.append((at_ns, topic, name, message))
    header, curves = opened(payload(read_flight(write(tmp_path, told)), made_by="test"))

    assert (curves["0/is_up"] == float(is_airborne)).all()
    assert (curves["1/is_up"] == 0.0).all()
    found_m = [pair[2] for pair in header["pairs"]]
    assert found_m == ([] if distance_m is None else [pytest.approx(distance_m, abs=0.001)])


def test_a_vehicle_that_a_person_lifts_before_the_flight_has_not_lifted_off(
    tmp_path: Path,
) -> None:
    told: list[Row] = []
    for at_ns, topic, name, message in rows(has_truth=False):
        if isinstance(message, Telemetry):
            is_flying = at_ns - BEGIN_NS >= 3 * SECOND
            message = msgspec.structs.replace(message, is_airborne=is_flying)
        told.append((at_ns, topic, name, message))
    flight = read_flight(write(tmp_path, told))

    assert flight.vehicles["mav0"].lift_off_s == pytest.approx(3.0, abs=0.11)


def test_without_telemetry_a_vehicle_is_up_from_its_first_height_on(tmp_path: Path) -> None:
    told = [row for row in rows(has_truth=False, ground_m=0.6) if not isinstance(row[3], Telemetry)]
    _, curves = opened(payload(read_flight(write(tmp_path, told)), made_by="test"))

    height_m = curves["0/z"] - 0.6
    assert (curves["0/is_up"][height_m < 0.02] == 0.0).all()
    assert (curves["0/is_up"][height_m > 0.09] == 1.0).all()


def test_the_age_of_what_each_knew_is_the_largest_of_each_step(folder: Path) -> None:
    _, curves = opened(payload(read_flight(folder), made_by="test"))

    ages_s = curves["0/age/1"]
    assert np.nanmax(ages_s) == pytest.approx(0.024, abs=0.001)
    assert np.nanmin(ages_s) == pytest.approx(0.020, abs=0.001)
    assert np.nanmax(np.abs(curves["0/avoided"] - 1.0)) == 0.0


def test_orders_have_author_answer_and_end(folder: Path) -> None:
    header, _ = opened(payload(read_flight(folder), made_by="test"))

    [order] = header["orders"]
    assert order["text"] == "takeoff of anna (from ground-1)"
    assert order["answer"] == "accepted"
    assert order["end"].endswith("At 1.00 m.")
    assert order["at_s"] == pytest.approx(1.0)
    [event] = header["events"]
    assert event == [3.0, "mav0", "warning", "order-takeoff", "At 1.00 m."]


def test_of_too_many_events_the_most_severe_ones_are_shown_by_time_and_the_page_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(payload_module, "MAX_EVENTS", 4)
    told = rows(length_s=2.0)
    severities: tuple[Severity, ...] = ("info", "debug", "info", "warning", "info", "critical")
    for number, severity in enumerate(severities):
        at_ns = BEGIN_NS + SECOND + number
        event = Event(
            vehicle="mav0", stamp_ns=at_ns, severity=severity, code=str(number), sentence="x"
        )
        told.append((at_ns, Topic.EVENT, "mav0", event))
    header, _ = opened(payload(read_flight(write(tmp_path, told)), made_by="test"))

    assert [event[3] for event in header["events"]] == ["0", "2", "3", "5"]
    assert "Only the 4 most severe of 6 events are shown." in header["notes"]


def test_of_too_many_orders_the_first_ones_are_shown_and_the_page_says_so(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight = read_flight(folder)
    header, _ = opened(payload(flight, made_by="test"))
    assert not [note for note in header["notes"] if note.startswith("Only")]

    monkeypatch.setattr(payload_module, "MAX_EVENTS", 2)
    header, _ = opened(payload(replace(flight, orders=3 * flight.orders), made_by="test"))
    assert len(header["orders"]) == 2
    assert "Only the first 2 of 3 orders are shown." in header["notes"]


def test_what_differs_from_its_default_is_marked(folder: Path) -> None:
    header, _ = opened(payload(read_flight(folder), made_by="test"))

    chosen = {f"{one[0]}.{one[1]}": (one[2], one[3]) for one in header["settings"] if one[4]}
    assert chosen["vehicles.mass_kg"] == ("0.51", "1")
    assert "fleet.safety_distance_m" not in chosen


def test_without_truth_the_page_shows_what_the_vehicles_took_for_their_position(
    tmp_path: Path,
) -> None:
    folder = write(tmp_path, rows(has_truth=False))
    header, curves = opened(payload(read_flight(folder), made_by="test"))

    assert not header["has_truth"]
    assert np.nanmax(curves["0/x"]) == pytest.approx(2.5, abs=0.1)
    assert header["pairs"][0][2] == pytest.approx(0.9, abs=0.01)


def test_another_flight_lies_beside_it_from_the_same_lift_off(folder: Path, tmp_path: Path) -> None:
    # the other record began two seconds before its vehicles did
    begin = Event(vehicle="ground", stamp_ns=BEGIN_NS, severity="info", code="x", sentence="x")
    late: list[Row] = [(BEGIN_NS, Topic.EVENT, "ground", begin)]
    for at_ns, topic, name, message in rows():
        late_ns = at_ns + 2 * SECOND
        late.append((late_ns, topic, name, msgspec.structs.replace(message, stamp_ns=late_ns)))
    other = write(tmp_path / "other", late)

    header, curves = opened(payload(read_flight(folder), made_by="test", ghost=read_flight(other)))

    assert header["ghost"] == "other"
    difference_m = np.abs(curves["0/ghost_x"] - curves["0/x"])
    assert np.nanmax(difference_m) < 0.02


def test_the_page_names_the_version_that_recorded(folder: Path) -> None:
    header, _ = opened(payload(read_flight(folder), made_by="test"))

    versions = dict(header["versions"])
    assert versions["covey"] == version("covey")
    assert versions["begin"] == "a test"


def test_a_long_flight_has_a_coarser_grid(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(payload_module, "MAX_SAMPLES", 200)

    header, curves = opened(payload(read_flight(folder), made_by="test"))

    assert header["step_s"] == 0.1
    # an intervention of one tick is still there
    assert np.nanmax(curves["0/intervention"]) == pytest.approx(1.0, abs=0.01)


def test_ticks_that_jitter_at_the_edge_of_a_step_leave_no_holes(tmp_path: Path) -> None:
    # mav1's ticks lie half a step beside mav0's, once just before and once just after the edge
    told: list[Row] = []
    for at_ns, topic, name, message in rows(length_s=2.0):
        if isinstance(message, TickSample) and name == "mav1":
            step = (at_ns - BEGIN_NS) * 50 // SECOND
            jitter_ns = 200_000 if step % 2 else -200_000
            at_ns += SECOND // 100 + jitter_ns
            message = msgspec.structs.replace(message, stamp_ns=at_ns)
        told.append((at_ns, topic, name, message))
    header, curves = opened(payload(read_flight(write(tmp_path, told)), made_by="test"))

    assert header["step_s"] == 0.02
    for curve in ("intervention", "avoided", "slack", "period", "age/0"):
        assert np.isfinite(curves[f"1/{curve}"][1:]).all()


def test_a_curve_ends_where_a_vehicle_falls_silent(tmp_path: Path) -> None:
    told = [row for row in rows() if row[2] == "mav0" or row[0] < BEGIN_NS + 5 * SECOND]
    _, curves = opened(payload(read_flight(write(tmp_path, told)), made_by="test"))

    known = np.flatnonzero(np.isfinite(curves["1/intervention"]))
    assert known[-1] == pytest.approx(5.0 / 0.02, abs=0.4 / 0.02)


def test_whom_it_avoids_is_that_of_the_largest_intervention_of_each_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # at one tick of five, which is the one at the grid's time, mav0 avoids nobody to speak of
    monkeypatch.setattr(payload_module, "MAX_SAMPLES", 200)
    told: list[Row] = []
    for at_ns, topic, name, message in rows():
        if isinstance(message, TickSample) and name == "mav0":
            is_at_grid = (at_ns - BEGIN_NS) % (SECOND // 10) == 0
            message = msgspec.structs.replace(
                message,
                active_neighbour="" if is_at_grid else "mav1",
                intervention_m_s2=0.1 if is_at_grid else 3.0,
            )
        told.append((at_ns, topic, name, message))
    header, curves = opened(payload(read_flight(write(tmp_path, told)), made_by="test"))

    assert header["step_s"] == 0.1
    assert np.nanmin(curves["0/intervention"]) == pytest.approx(3.0, abs=0.01)
    assert np.nanmin(curves["0/avoided"]) == 1.0


def test_fix_and_age_of_corrections_are_curves_of_vehicles_by_satellites(tmp_path: Path) -> None:
    told = []
    for at_ns, topic, name, message in rows():
        if isinstance(message, Telemetry) and name == "mav0":
            message = msgspec.structs.replace(message, fix="RTK float", corrections_age_s=0.6)
        told.append((at_ns, topic, name, message))
    _, curves = opened(payload(read_flight(write(tmp_path, told)), made_by="test"))

    assert np.nanmin(curves["0/fix"]) == np.nanmax(curves["0/fix"]) == 5.0
    assert np.nanmax(curves["0/corrections_age"]) == pytest.approx(0.6, abs=0.01)
    assert "1/fix" not in curves  # it flies by a mocap


def test_every_fix_that_a_vehicle_tells_has_its_number() -> None:
    assert list(FIX_NUMBERS) == list(FIX_WORDS)
    assert list(FIX_NUMBERS.values()) == [*range(len(FIX_WORDS))]
