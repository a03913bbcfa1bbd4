"""A PX4 that has restarted: the link counts it, and from its first message on knows no origin."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from onboard.autopilot import Snapshot
from onboard.px4 import mavsdk_link
from tests.onboard.px4.wire import Wire, wired

_ORIGIN = (473977060, 85455408, 489400)  # 1e-7 degrees and mm
_OTHER = (473976790, 85455408, 489400)  # 3 m further south


def _position(wire: Wire, boot_ms: int) -> Snapshot:
    """Have PX4 send its local position, and return the snapshot with it."""
    before_ns = wire.link.snapshot().local_position_ns
    wire.send(wire.mav.local_position_ned_encode(boot_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    return wire.until(lambda snapshot: snapshot.local_position_ns > before_ns)


def _tell_origin(wire: Wire, place: tuple[int, int, int]) -> None:
    """Have PX4 send its global origin, and wait until the link knows it."""
    wire.send(wire.mav.gps_global_origin_encode(*place))
    latitude_deg = place[0] * 1e-7
    wire.until(
        lambda snapshot: (
            snapshot.global_origin is not None
            and snapshot.global_origin[0] == pytest.approx(latitude_deg, abs=1e-9)
        )
    )


@pytest.fixture
def wire() -> Iterator[Wire]:
    """A link that knows the origin of a PX4 that has run for ten minutes."""
    with wired() as found:
        found.attitude(600_000)
        _tell_origin(found, _ORIGIN)
        yield found


def test_its_first_local_position_is_not_counted_from_the_origin_of_before(wire: Wire) -> None:
    """PX4 sends local positions a second before its first attitude and its new origin."""
    assert _position(wire, 600_020).global_origin is not None
    assert _position(wire, 400).global_origin is None


def test_the_origin_that_it_tells_after_the_restart_stays(wire: Wire) -> None:
    _position(wire, 400)
    _tell_origin(wire, _OTHER)
    assert wire.attitude(2_400).global_origin is not None
    assert _position(wire, 2_420).global_origin is not None


def test_messages_that_overtake_each_other_are_no_restart(wire: Wire) -> None:
    snapshot = _position(wire, 599_600)
    assert snapshot.global_origin is not None
    assert snapshot.restarts == 0


def test_a_px4_that_is_heard_again_after_a_pulled_cable_is_counted(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mavsdk_link, "_SILENT_NS", 100_000_000)
    before = wire.attitude(600_020)
    time.sleep(0.15)
    after = wire.attitude(600_170)
    assert after.returns > before.returns
    assert after.restarts == 0
    assert after.global_origin is not None


def test_a_px4_that_is_heard_all_the_time_does_not_count_as_heard_again(wire: Wire) -> None:
    assert wire.attitude(600_020).returns == 0


def test_a_restart_is_counted_although_its_clock_has_caught_up_since(wire: Wire) -> None:
    assert wire.attitude(600_020).restarts == 0
    assert _position(wire, 400).restarts == 1
    assert wire.attitude(700_000).restarts == 1
    assert _position(wire, 300).restarts == 2
