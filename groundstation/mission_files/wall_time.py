"""Reads wall-clock times (times of day) as people write them. Pure: `now` is an argument.

A time without a date is the nearest one in the future: at 23:50, ``00:10`` is twenty minutes ahead.
A time is in this computer's time zone unless it names another one. If the clocks change to or from
summer time before then, that is taken into account::

    21:30    21:30:00    2026-11-26 21:30:00    20:30:00Z    21:30:00+01:00
"""

from __future__ import annotations

import datetime
import re
import time as clock
from typing import NamedTuple

from onboard.config.fleet import ConfigError

LONGEST_S = 6.0 * 3600.0  # longest wait for a start; batteries and people do not wait longer

_FORMAT = re.compile(
    r"((?P<date>\d{4}-\d{2}-\d{2})[T ])?"
    r"(?P<time>\d{1,2}:\d{2}(:\d{2})?)"
    r"(?P<zone>Z|[+-]\d{2}:\d{2})?"
)
_MINUTE_S = 60.0
_HOUR_S = 3600.0
_DAY_S = 86400.0
_YEAR_S = 365.25 * _DAY_S


class _ThisZone(datetime.tzinfo):
    """This computer's time zone, whose offset may change twice a year."""

    def utcoffset(self, instant: datetime.datetime | None) -> datetime.timedelta | None:
        """Return the offset at a local time."""
        return _with_system_offset(instant).utcoffset()

    def tzname(self, instant: datetime.datetime | None) -> str | None:
        """Return the name of the zone at a local time."""
        return _with_system_offset(instant).tzname()

    def dst(self, instant: datetime.datetime | None) -> datetime.timedelta | None:
        """Return None: how much of the offset is summer time is not needed."""
        return None

    def fromutc(self, instant: datetime.datetime) -> datetime.datetime:
        """Return the local time of an instant, which is given in UTC."""
        local = instant.replace(tzinfo=datetime.UTC).astimezone().replace(tzinfo=self)
        if local.utcoffset() != local - instant:
            # the clocks are put back in this night, and this is the second of two equal times
            local = local.replace(fold=1)
        return local


def _with_system_offset(instant: datetime.datetime | None) -> datetime.datetime:
    """Return a local time with the offset that the system has for it."""
    assert instant is not None
    try:
        return instant.replace(tzinfo=None).astimezone()
    except (OverflowError, ValueError):  # the first or the last day that Python can represent
        standard = datetime.timezone(datetime.timedelta(seconds=-clock.timezone))
        return instant.replace(tzinfo=standard)


class WallTime(NamedTuple):
    """An instant of the wall clock."""

    words: str  # the time for people, with its time zone
    wall_ns: int  # time since 1970 [ns]


def check_wall_time(written: str) -> None:
    """Refuse a text that is not a time.

    Args:
        written: time as a person has written it.

    Raises:
        ConfigError: the text is not a time.
    """
    _parsed(written)


def wall_time(written: str, now: datetime.datetime) -> WallTime:
    """Return the instant that a person has written.

    Args:
        written: time as a person has written it.
        now: the wall clock, with its time zone.

    Raises:
        ConfigError: the text is not a time, or the time is in the past or too far ahead.
    """
    date, time = _parsed(written)

    if date is not None:
        days = [date]
    else:
        # in another time zone it may be the day before, or the day after
        days = [now.date() + datetime.timedelta(days=shift) for shift in (-1, 0, 1)]
    # in a night in which the clocks are put back, a time may come twice
    instants = [_instant(day, time.replace(fold=fold), now) for day in days for fold in (0, 1)]
    instant = _nearest(instants, now)

    ahead_s = _ahead_s(instant, now)
    words = _instant_words(instant, now)
    if ahead_s <= 0.0:
        raise ConfigError(
            f"{words} was {time_words(abs(ahead_s))} ago: it is {now:%H:%M:%S}. "
            "Give a time to come."
        )
    if ahead_s > LONGEST_S:
        raise ConfigError(
            f"{words} is {time_words(ahead_s)} from now; a start is at most "
            f"{time_words(LONGEST_S)} ahead. Give the order later."
        )
    return WallTime(words, round(instant.timestamp() * 1e9))


def local_now(wall_ns: int) -> datetime.datetime:
    """Return a wall-clock time in this computer's time zone.

    Args:
        wall_ns: time since 1970 [ns].
    """
    utc = datetime.datetime.fromtimestamp(wall_ns * 1e-9, datetime.UTC)
    return utc.astimezone(_ThisZone())


def time_words(time_s: float) -> str:
    """Return a length of time in words: "0.31 s", "45 s", "12 min 34 s", "3 h 20 min", "4 days".

    Args:
        time_s: length of time, not negative [s].
    """
    if time_s < 1.0:
        return f"{time_s:.2g} s"
    if time_s < 10.0:
        return f"{time_s:.1f} s"
    if time_s < _MINUTE_S:
        return f"{time_s:.0f} s"
    if time_s < _HOUR_S:
        minutes, seconds = divmod(round(time_s), 60)
        return f"{minutes} min {seconds} s" if seconds else f"{minutes} min"
    if time_s < 2.0 * _DAY_S:
        hours, minutes = divmod(round(time_s / _MINUTE_S), 60)
        return f"{hours} h {minutes} min" if minutes else f"{hours} h"
    if time_s < _YEAR_S:
        return f"{time_s / _DAY_S:.0f} days"
    return f"{time_s / _YEAR_S:.1f} years"


def _parsed(written: str) -> tuple[datetime.date | None, datetime.time]:
    """Return the date and the time of day in a text; the date is None if the text has none."""
    match = None
    if isinstance(written, str):  # a Python mission may give anything
        match = _FORMAT.fullmatch(written.strip())
    problem = ConfigError(
        f"'{written!s:.40}' is no time of day. Write 21:30, 21:30:00, or with a date and a zone "
        "2026-11-26 21:30:00+01:00."
    )
    if match is None:
        raise problem

    try:
        hours, minutes = match["time"].split(":", 1)
        time = datetime.time.fromisoformat(f"{hours.zfill(2)}:{minutes}{match['zone'] or ''}")
        if match["date"] is None:
            return None, time
        return datetime.date.fromisoformat(match["date"]), time
    except ValueError:
        raise problem from None


def _instant(date: datetime.date, time: datetime.time, now: datetime.datetime) -> datetime.datetime:
    """Return an instant in this computer's time zone; the time itself may name another zone."""
    instant = datetime.datetime.combine(date, time)
    if instant.tzinfo is None:
        return instant.replace(tzinfo=now.tzinfo)
    try:
        return instant.astimezone(now.tzinfo)
    except OverflowError:  # the first or the last day that Python can represent
        return instant.replace(tzinfo=now.tzinfo)


def _nearest(instants: list[datetime.datetime], now: datetime.datetime) -> datetime.datetime:
    """Return the first instant that a start may wait for; if there is none, the nearest to now."""
    for instant in instants:
        if 0.0 < _ahead_s(instant, now) <= LONGEST_S:
            return instant
    return min(instants, key=lambda instant: abs(_ahead_s(instant, now)))


def _ahead_s(instant: datetime.datetime, now: datetime.datetime) -> float:
    """Return the time from now to an instant; a plain difference would be one of local times."""
    return instant.timestamp() - now.timestamp()


def _instant_words(instant: datetime.datetime, now: datetime.datetime) -> str:
    date_words = ""
    if instant.date() != now.date():
        date_words = f"{instant:%Y-%m-%d} "
    return f"{date_words}{instant:%H:%M:%S} {instant.tzname() or ''}".rstrip()
