"""Times of the wall clock, as people write them."""

from __future__ import annotations

import datetime
import time
from collections.abc import Iterator

import pytest

from groundstation.mission_files.wall_time import local_now, time_words, wall_time
from onboard.config.fleet import ConfigError

ZONE = datetime.timezone(datetime.timedelta(hours=1), "CET")


def at(hours: int, minutes: int = 0, seconds: int = 0, *, day: int = 26) -> datetime.datetime:
    return datetime.datetime(2026, 11, day, hours, minutes, seconds, tzinfo=ZONE)


@pytest.mark.parametrize(
    ("written", "now", "meant"),
    [
        ("21:30:00", at(21, 17), at(21, 30)),
        ("21:30", at(21, 17), at(21, 30)),
        (" 9:05:07 ", at(9), at(9, 5, 7)),
        ("20:30:00Z", at(21, 17), at(21, 30)),
        ("22:30:00+02:00", at(21, 17), at(21, 30)),
        ("2026-11-26 21:30", at(21, 17), at(21, 30)),
        ("2026-11-26T21:30:00", at(21, 17), at(21, 30)),
        ("00:10", at(23, 50), at(0, 10, day=27)),
        ("23:30:00Z", at(23, 50), at(0, 30, day=27)),
    ],
)
def test_a_time_is_the_nearest_one_to_come(
    written: str, now: datetime.datetime, meant: datetime.datetime
) -> None:
    assert wall_time(written, now).wall_ns == round(meant.timestamp() * 1e9)


def test_the_words_name_the_zone_and_another_day() -> None:
    assert wall_time("21:30", at(21)).words == "21:30:00 CET"
    assert wall_time("00:10", at(23, 50)).words == "2026-11-27 00:10:00 CET"


@pytest.fixture
def central_europe(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """This computer's clock is put forward in March and back in October."""
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "CET-1CEST,M3.5.0,M10.5.0/3")
        time.tzset()
        yield
    time.tzset()


@pytest.mark.parametrize(
    ("now_utc", "written", "meant_utc", "words"),
    [
        ("2026-10-24 21:50", "03:30", "2026-10-25 02:30", "2026-10-25 03:30:00 CET"),
        ("2026-10-24 21:50", "01:30", "2026-10-24 23:30", "2026-10-25 01:30:00 CEST"),
        ("2026-10-24 21:50", "2026-10-25 03:30", "2026-10-25 02:30", "2026-10-25 03:30:00 CET"),
        ("2026-10-25 00:20", "02:30", "2026-10-25 00:30", "02:30:00 CEST"),
        ("2026-10-25 00:40", "02:30", "2026-10-25 01:30", "02:30:00 CET"),
        ("2026-10-25 01:20", "02:30", "2026-10-25 01:30", "02:30:00 CET"),
        ("2026-10-25 01:20", "01:40:00Z", "2026-10-25 01:40", "02:40:00 CET"),
        ("2026-03-28 22:50", "03:30", "2026-03-29 01:30", "2026-03-29 03:30:00 CEST"),
    ],
)
def test_a_time_in_a_night_in_which_the_clocks_change_counts_by_its_own_offset(
    central_europe: None, now_utc: str, written: str, meant_utc: str, words: str
) -> None:
    def wall_ns(text: str) -> int:
        instant = datetime.datetime.fromisoformat(text).replace(tzinfo=datetime.UTC)
        return round(instant.timestamp() * 1e9)

    meant = wall_time(written, local_now(wall_ns(now_utc)))
    assert meant == (words, wall_ns(meant_utc))


@pytest.mark.parametrize("written", ["0001-01-01 00:00", "9999-12-31 23:59"])
def test_the_first_and_the_last_day_are_refused_in_words(
    central_europe: None, written: str
) -> None:
    with pytest.raises(ConfigError):
        wall_time(written, local_now(1_795_000_000 * 10**9))


@pytest.mark.parametrize(
    ("written", "sentence"),
    [
        ("21:12:00", "21:12:00 CET was 5 min ago: it is 21:17:00. Give a time to come."),
        ("21:17:00", "21:17:00 CET was 0 s ago"),
        ("05:00", "2026-11-27 05:00:00 CET is 7 h 43 min from now; a start is at most 6 h ahead"),
        ("2026-11-25 21:30", "was 23 h 47 min ago"),
        ("2027-11-26 21:30", "is 365 days from now"),
        ("1970-01-01 00:00", "was 56.9 years ago"),
        ("", "is no time of day"),
        ("now", "is no time of day"),
        ("25:00", "is no time of day"),
        ("21:60", "is no time of day"),
        ("21", "is no time of day"),
        ("2130", "is no time of day"),
        ("21:30:00.5", "is no time of day"),
        ("2026-02-30 21:30", "is no time of day"),
        ("9999-12-31 23:59", "from now"),
        ("0001-01-01 00:00", "ago"),
        ("21:30 CET", "is no time of day"),
        ("x" * 500, "is no time of day"),
    ],
)
def test_what_is_no_time_to_come_is_refused_in_words(written: str, sentence: str) -> None:
    with pytest.raises(ConfigError) as caught:
        wall_time(written, at(21, 17))
    assert sentence in str(caught.value)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize(
    ("time_s", "words"),
    [
        (0.0, "0 s"),
        (0.312, "0.31 s"),
        (3.24, "3.2 s"),
        (45.4, "45 s"),
        (754.0, "12 min 34 s"),
        (600.0, "10 min"),
        (12000.0, "3 h 20 min"),
        (7200.0, "2 h"),
        (4 * 86400.0, "4 days"),
    ],
)
def test_lengths_of_time_are_said_in_words(time_s: float, words: str) -> None:
    assert time_words(time_s) == words
