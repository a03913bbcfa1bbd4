"""PX4's logs as they are read: from a card that was pulled out, from anybody, of a fleet."""

from __future__ import annotations

import json
import random
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from groundstation.cli import main
from groundstation.px4_logs import px4_log
from groundstation.px4_logs.flight_logs import logs_of_flight
from groundstation.px4_logs.log_summary import fleet_lines, lines
from groundstation.px4_logs.px4_log import read_log
from groundstation.recording.flight_reading import read_flight
from groundstation.report.payload import payload
from onboard.config.fleet import ConfigError
from sitl.px4.flight_log import LogWriter, _message
from tests.groundstation.px4_logs.made_up_logs import (
    log_bytes,
    write_flight_with_logs,
    write_log,
)
from tests.groundstation.report.made_up import opened

LENGTH_S = 14.0
LENGTH_OF_LOG_S = 9.0
START_S = 300.0


@pytest.fixture(scope="module")
def flight_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two vehicles that tilt differently; their logs begin 3 s after the record."""
    return write_flight_with_logs(
        tmp_path_factory.mktemp("flight"), length_s=LENGTH_S, log_s=LENGTH_OF_LOG_S, start_s=START_S
    )


def test_a_log_is_read_with_what_it_says_of_itself(tmp_path: Path) -> None:
    log = read_log(write_log(tmp_path / "a.ulg", length_s=LENGTH_OF_LOG_S, start_s=START_S))
    assert (log.begin_s, log.length_s) == (300.0, pytest.approx(8.98))
    assert log.about == {"version": "1.17", "MAVLink id": "3"}
    assert log.attitude.size == 450
    assert [(text.level, text.text) for text in log.texts] == [
        ("info", "Armed by external command"),
        ("warning", "Battery <b>low</b>"),
    ]
    said = "\n".join(lines(log))
    assert "9.0 s, armed for 8.0 s" in said
    assert "Battery: 16.0 V to 15.9 V, 90 % to 89 %." in said
    assert "Modes: Hold from 0.0 s, Offboard from 6.0 s." in said
    assert "9.50 s  warning  Battery <b>low</b>" in said


def test_the_logs_of_a_fleet_lie_on_one_clock(flight_folder: Path) -> None:
    found = logs_of_flight(flight_folder, read_flight(flight_folder))
    assert set(found.logs) == {"mav0", "mav1"}
    for one in found.logs.values():
        assert one.begin_s == pytest.approx(3.0, abs=0.02)
        assert one.alignment.residual_deg < 0.3
    east_m = found.logs["mav1"].position_enu_m.values[:, 0]
    assert np.median(east_m) == pytest.approx(0.0, abs=0.1)  # wherever PX4's own frame begins
    said = "\n".join(fleet_lines(found))
    assert said.index("mav0") < said.index("mav1")
    assert "12.50 s  mav0             warning  Battery <b>low</b>" in said


def test_a_log_without_a_date_is_older_than_those_with_one(
    flight_folder: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "flight"
    shutil.copytree(flight_folder, folder)
    undated = folder / "px4" / "mav0-sess012_log001.ulg"
    write_log(undated, shift_s=3.0, seed=1, length_s=LENGTH_OF_LOG_S, start_s=900.0)
    found = logs_of_flight(folder, read_flight(folder))
    assert found.logs["mav0"].log.begin_s == START_S


def test_a_log_of_another_vehicle_is_left_out_with_the_reason(
    flight_folder: Path, tmp_path: Path
) -> None:
    flight = read_flight(flight_folder)
    write_log(
        tmp_path / "px4" / "mav0-2026-11-26_09_00_00.ulg",
        seed=7,
        length_s=LENGTH_OF_LOG_S,
        start_s=START_S,
    )
    write_log(
        tmp_path / "px4" / "mav0-2026-11-26_08_00_00.ulg",
        seed=1,
        shift_s=3.0,
        length_s=LENGTH_OF_LOG_S,
        start_s=START_S,
    )
    write_log(
        tmp_path / "px4" / "mav1-2026-11-26_08_00_00.ulg",
        seed=7,
        length_s=LENGTH_OF_LOG_S,
        start_s=START_S,
    )
    (tmp_path / "px4" / "stranger-1.ulg").write_bytes(b"ULog")
    found = logs_of_flight(tmp_path, flight)
    assert found.logs["mav0"].log.path.endswith("08_00_00.ulg")
    (note,) = found.notes
    assert note.startswith("mav1-2026-11-26_08_00_00.ulg is left out. The log is of another")


def test_the_report_has_px4s_curves_and_words_beside_the_records(flight_folder: Path) -> None:
    flight = read_flight(flight_folder)
    logs = logs_of_flight(flight_folder, flight)
    header, curves = opened(payload(flight, made_by="test", logs=logs))
    assert [one["vehicle"] for one in header["px4"]] == [0, 1]
    assert header["px4"][0]["texts"][1] == [
        pytest.approx(12.5, abs=0.02), "warning", "Battery <b>low</b>",
    ]  # fmt: skip
    for angle in ("roll", "pitch"):
        difference_deg = curves[f"0/px4_{angle}"] - curves[f"0/own_{angle}"]
        assert np.isfinite(difference_deg).sum() > 400
        spread_deg = np.nanstd(curves[f"0/px4_{angle}"])
        assert np.nanstd(difference_deg) < 0.4 * spread_deg
        assert np.nanstd(curves[f"0/px4_{angle}"]) > 1.0
    assert np.nanmedian(curves["0/px4_heading"]) == pytest.approx(17.2, abs=1.0)
    assert np.nanmedian(curves["0/own_heading"]) == pytest.approx(5.7, abs=1.0)
    assert np.nanmax(curves["0/px4_voltage"]) == pytest.approx(16.0, abs=0.01)
    header, _ = opened(payload(flight, made_by="test"))
    assert header["px4"] == []


@pytest.mark.long
def test_a_log_of_ten_minutes_whose_clock_drifts_lies_on_the_records_clock(tmp_path: Path) -> None:
    write_flight_with_logs(tmp_path, length_s=600.0, log_s=590.0, start_s=START_S, drift_frac=50e-6)
    flight = read_flight(tmp_path)

    begin_s = time.process_time()
    found = logs_of_flight(tmp_path, flight)
    _, curves = opened(payload(flight, made_by="test", logs=found))
    cost_s = time.process_time() - begin_s
    print(f"two logs of ten minutes: {cost_s:.1f} s of processor")

    for one in found.logs.values():
        assert one.begin_s == pytest.approx(3.0, abs=0.01)
        assert one.end_s == pytest.approx(593.0, abs=0.03)
        assert one.alignment.drift_frac == pytest.approx(-50e-6, abs=10e-6)
    for part in (slice(200, 1_000), slice(-2_000, -1_000)):  # begin and end fit alike
        difference_deg = curves["0/px4_roll"][part] - curves["0/own_roll"][part]
        assert np.nanstd(difference_deg) < 0.2


def test_the_command_says_a_log_and_the_logs_of_a_flight(
    flight_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (path, _) = sorted((flight_folder / "px4").iterdir())
    assert main(["log", "info", str(path)]) == 0
    assert "attitude" in capsys.readouterr().out
    assert main(["log", "info", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["texts"][0][1] == "info"
    assert main(["log", "info", str(flight_folder)]) == 0
    assert "PX4's own logs, on the record's clock:" in capsys.readouterr().out


# -- bad input -------------------------------------------------------------------------------------


def outcome(path: Path, data: bytes) -> str:
    """What becomes of some bytes: the sentence of the refusal, or nothing."""
    path.write_bytes(data)
    try:
        read_log(path)
    except ConfigError as error:
        return str(error)
    return ""


def cuts(data: bytes, path: Path, places: list[int]) -> int:
    """Cut a log at places; the number of those that were opened in part."""
    opened_count = 0
    for place in places:
        said = outcome(path, data[:place])
        assert "Traceback" not in said
        opened_count += not said
    return opened_count


def test_a_log_that_was_cut_is_opened_in_part_or_refused(tmp_path: Path) -> None:
    data = log_bytes(length_s=1.0, start_s=300.0)
    places = list(range(0, len(data), 97))
    assert cuts(data, tmp_path / "a.ulg", places) > len(places) / 2


@pytest.mark.long
def test_a_log_that_was_cut_anywhere_is_opened_in_part_or_refused(tmp_path: Path) -> None:
    data = log_bytes(length_s=1.0, start_s=300.0)
    assert cuts(data, tmp_path / "a.ulg", list(range(len(data)))) > len(data) / 2


def test_a_log_with_other_bytes_in_it_is_opened_in_part_or_refused(tmp_path: Path) -> None:
    data = log_bytes(length_s=1.0, start_s=300.0)
    rng = random.Random(1)
    for _ in range(60):
        bad = bytearray(data)
        for _ in range(rng.randrange(1, 20)):
            bad[rng.randrange(8, len(bad))] = rng.randrange(256)
        outcome(tmp_path / "a.ulg", bytes(bad))


def test_what_is_no_log_is_refused_in_a_sentence(tmp_path: Path) -> None:
    assert "no log of PX4" in outcome(tmp_path / "a.ulg", b"%PDF-1.4 and so on")
    assert "nothing of a flight" in outcome(tmp_path / "a.ulg", bytes(LogWriter(0, {}, {}).content))


def test_types_that_hold_each_other_again_and_again_are_refused(tmp_path: Path) -> None:
    data = LogWriter(0, {}, {}).content
    head = bytes(data[:16])
    bomb = _message("F", b"a0:uint8_t[60000] x;")
    for depth in range(1, 6):
        bomb += _message("F", f"a{depth}:a{depth - 1}[60000] x;".encode())
    assert f"more than {px4_log._MAX_FIELDS} fields" in outcome(tmp_path / "a.ulg", head + bomb)
    itself = _message("F", b"a:a x;a y;")
    assert "fields" in outcome(tmp_path / "a.ulg", head + itself)
