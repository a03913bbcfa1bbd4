"""Time of a packet in the air, beside published figures, and what a fleet takes of one channel."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from onboard.config.fleet import FleetConfig, RadioConfig, fleet_from_mapping
from onboard.feasibility.airtime import DSSS_SHORT, airtime_finding, frame_s
from onboard.neighbours.subscription import most_near
from tests.bench.fixture import fleet_data


def _fleet(count: int, spacing_m: float) -> FleetConfig:
    return fleet_from_mapping(fleet_data(count, spacing_m))


@pytest.mark.parametrize(
    ("packet_bytes", "rate_mbit_s", "published_bit_s"),
    [
        (128, 11.0, 1_472_033),
        (128, 5.5, 1_249_889),
        (128, 2.0, 817_891),
        (256, 11.0, 2_596_588),
        (256, 5.5, 2_036_889),
        (256, 2.0, 1_160_997),
    ],
)
def test_throughput_of_small_packets_is_as_published_for_802_11b(
    packet_bytes: int, rate_mbit_s: float, published_bit_s: float
) -> None:
    assert 8 * packet_bytes / frame_s(packet_bytes, rate_mbit_s, DSSS_SHORT) == pytest.approx(
        published_bit_s, rel=1e-3
    )


def test_a_state_takes_a_quarter_of_a_millisecond_and_hardly_less_at_ten_times_the_rate() -> None:
    assert 200e-6 < frame_s(400, 65.0) < 300e-6
    assert frame_s(400, 650.0) > 0.7 * frame_s(400, 65.0)


def test_three_vehicles_fit_into_one_channel_and_thirty_near_each_other_do_not() -> None:
    for count, status in ((3, "ok"), (30, "refused")):
        fleet = _fleet(count, 2.0)
        starts = {name: vehicle.start_enu_m for name, vehicle in fleet.vehicles.items()}
        finding = airtime_finding(fleet, RadioConfig(), most_near(fleet, starts))
        assert finding.status == status, finding.sentence


def test_half_the_rate_of_states_and_direct_links_take_less_of_the_channel() -> None:
    fleet = _fleet(8, 2.0)
    radio = RadioConfig()
    whole = airtime_finding(fleet, radio, 4).value
    assert airtime_finding(fleet, replace(radio, states_hz=25), 4).value < 0.8 * whole
    assert airtime_finding(fleet, replace(radio, rate_mbit_s=130.0), 4).value < whole


def test_who_is_near_depends_on_the_constellation_and_is_bounded_by_what_the_law_uses() -> None:
    close = _fleet(20, 1.0)
    wide = _fleet(20, 20.0)
    counts = [
        most_near(one, {name: v.start_enu_m for name, v in one.vehicles.items()})
        for one in (close, wide)
    ]
    assert counts == [12, 4]
