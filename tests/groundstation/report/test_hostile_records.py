"""Records that are cut, damaged, of other versions, or made by somebody who means ill."""

from __future__ import annotations

import contextlib
import random
from pathlib import Path

import msgspec
import numpy as np
import pytest

from groundstation.recording import flight_reading
from groundstation.recording.flight_reading import read_flight
from groundstation.recording.writer import RecordFiles
from groundstation.report.payload import payload
from onboard.bus.schema import Truth
from onboard.config.fleet import ConfigError
from tests.groundstation.recorded import SECOND, tick
from tests.groundstation.report.made_up import BEGIN_NS, Row, opened, rows, write

STRANGE = (
    b"[1]",
    b"{}",
    b"nul",
    b'{"position_enu_m": 3}',
    b'{"position_enu_m": [1e999, 0, 1' + b"0" * 400 + b"]}",
    b'{"position_enu_m": [[], {}, "x"], "period_s": "slow"}',
    b'{"neighbour_ages_s": [1, 2]}',
    b"[" * 100_000,
    b"\xff",
)


def moved(told: list[Row], by_ns: int, *, names: tuple[str, ...] | None = None) -> list[Row]:
    """The same messages of a clock that differs."""
    found = []
    for at_ns, topic, name, message in told:
        if names is None or name in names:
            stamp_ns = message.stamp_ns + by_ns  # type: ignore[attr-defined]
            message = msgspec.structs.replace(message, stamp_ns=stamp_ns)
        found.append((at_ns, topic, name, message))
    return found


def received_later(told: list[Row], by_ns: int) -> list[Row]:
    """The same messages, which the recorder writes later."""
    return [(at_ns + by_ns, topic, name, message) for at_ns, topic, name, message in told]


def test_a_record_that_was_cut_anywhere_opens_in_part_or_is_refused(tmp_path: Path) -> None:
    folder = write(tmp_path, rows(length_s=2.0))
    path = folder / "flight.mcap"
    whole = path.read_bytes()

    opened_count = 0
    for size in range(0, len(whole), max(1, len(whole) // 30)):
        path.write_bytes(whole[:size])
        try:
            flight = read_flight(folder)
        except ConfigError:
            continue
        opened_count += 1
        assert any("cut off" in note for note in flight.notes), size
        header, _ = opened(payload(flight, made_by="test"))
        assert header["notes"]
    assert opened_count > 10


def test_flipped_bits_never_end_with_an_exception(tmp_path: Path) -> None:
    folder = write(tmp_path, rows(length_s=1.0))
    path = folder / "flight.mcap"
    whole = path.read_bytes()
    dice = random.Random(7)
    for attempt in range(40):
        damaged = bytearray(whole)
        for _ in range(1 + attempt % 3):
            damaged[dice.randrange(len(whole))] ^= 1 << dice.randrange(8)
        path.write_bytes(damaged)
        with contextlib.suppress(ConfigError):
            payload(read_flight(folder), made_by="test")


@pytest.mark.parametrize("data", STRANGE)
def test_messages_of_another_shape_are_left_out_and_counted(tmp_path: Path, data: bytes) -> None:
    files = RecordFiles(tmp_path, (tmp_path / "flight.mcap").open("wb"), begin_ns=0, begin="test")
    for at_ns, topic, name, message in rows(length_s=1.0):
        files.write(topic, name, message, at_ns)
    files.add_raw("truth/mav0", Truth, BEGIN_NS + SECOND + 1, data)
    files.add_raw("tick/mav1", type(tick(1)), BEGIN_NS + SECOND + 1, data)
    files.finish()
    files.close()

    flight = read_flight(tmp_path)

    _, curves = opened(payload(flight, made_by="test"))
    assert np.nanmax(np.abs(curves["0/x"])) < 10.0


@pytest.mark.parametrize("stamp_ns", [0, 1 << 62, (1 << 63) - 1])
def test_one_absurd_stamp_does_not_stretch_the_flight(tmp_path: Path, stamp_ns: int) -> None:
    told = moved(rows(), 10 * 86_400 * SECOND)
    wrong = [msgspec.structs.replace(message, stamp_ns=stamp_ns) for _, _, _, message in told[:1]]
    at_ns, topic, name, _ = told[0]
    folder = write(tmp_path, [*told, (at_ns, topic, name, wrong[0])])

    flight = read_flight(folder)

    assert 9.0 < flight.length_s < 30.0


def test_a_clock_that_jumps_in_flight_leaves_a_flight_of_a_right_length(tmp_path: Path) -> None:
    told = rows()
    half = len(told) // 2
    jumped = [*told[:half], *moved(told[half:], 3 * 86_400 * SECOND)]
    folder = write(tmp_path, jumped)

    flight = read_flight(folder)

    assert 4.0 < flight.length_s < 30.0
    payload(flight, made_by="test")


def test_flights_with_a_long_pause_between_them_are_all_in_the_page(tmp_path: Path) -> None:
    first = rows(length_s=4.0)
    pause_ns = 8 * 3600 * SECOND
    second = received_later(moved(rows(length_s=10.0), pause_ns), pause_ns)
    folder = write(tmp_path, [*first, *second])

    flight = read_flight(folder)

    assert flight.length_s == pytest.approx(8 * 3600.0 + 10.0, abs=1.0)
    time_s = flight.vehicles["mav0"].ticks.time_s
    assert np.count_nonzero(time_s < 5.0) == 200
    assert time_s.size == 700
    assert not any("far from" in note for note in flight.notes)


def test_one_stamp_that_is_hours_late_does_not_stretch_the_flight(tmp_path: Path) -> None:
    told = rows()
    late_ns = 3 * 3600 * SECOND
    folder = write(tmp_path, [*told, *moved(told[-1:], late_ns)])

    flight = read_flight(folder)

    assert flight.length_s == pytest.approx(10.0, abs=1.0)
    assert any("1 messages have stamps far from" in note for note in flight.notes)


def test_a_clock_that_is_set_back_between_two_flights_exchanges_none(tmp_path: Path) -> None:
    first = moved(rows(length_s=4.0), 3 * 3600 * SECOND)
    folder = write(tmp_path, [*first, *received_later(rows(length_s=10.0), 60 * SECOND)])

    flight = read_flight(folder)

    assert flight.length_s == pytest.approx(10.0, abs=1.0)
    assert any("far from" in note for note in flight.notes)


def test_a_vehicle_whose_clock_differs_is_put_on_the_common_one(tmp_path: Path) -> None:
    told = rows(has_truth=False)
    folder = write(tmp_path, moved(told, 7_000 * SECOND, names=("mav1",)))

    header, _ = opened(payload(read_flight(folder), made_by="test"))

    assert header["pairs"][0][2] == pytest.approx(0.9, abs=0.06)


def test_only_so_many_vehicles_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flight_reading, "MAX_VEHICLES", 1)
    folder = write(tmp_path, rows(length_s=1.0))

    flight = read_flight(folder)

    assert len(flight.vehicles) == 1
    assert any("more than 1 vehicles" in note for note in flight.notes)


@pytest.mark.parametrize("fleet", ["", "this is no TOML", "schema = 1\n[fleet]\nname = 3\n"])
def test_without_a_usable_fleet_file_the_page_says_so(tmp_path: Path, fleet: str) -> None:
    folder = write(tmp_path, rows(length_s=1.0), fleet=fleet)

    header, _ = opened(payload(read_flight(folder), made_by="test"))

    assert header["fleet"] is None
    assert any("fleet" in note for note in header["notes"])


@pytest.mark.parametrize(
    "verdict",
    [
        "[]",
        "{",
        '{"steps": 3, "checks": [1], "passed": "yes"}',
        '{"touchdowns": 1}',
        '{"touchdowns": [{"vehicle": "mav0"}]}',
    ],
)
def test_a_verdict_of_another_shape_does_not_stop_the_page(tmp_path: Path, verdict: str) -> None:
    folder = write(tmp_path, rows(length_s=1.0))
    (folder / "verdict.json").write_text(verdict)

    header, _ = opened(payload(read_flight(folder), made_by="test"))
    assert header["falls"] == []


def test_an_empty_record_is_refused_in_a_sentence(tmp_path: Path) -> None:
    folder = write(tmp_path, [])

    with pytest.raises(ConfigError, match=r"[Nn]othing of a flight|no vehicle"):
        read_flight(folder)
