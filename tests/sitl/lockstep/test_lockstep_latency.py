"""The lag of a mocap's stamps, found from a flight: the emulated PX4's attitude beside poses
stamped on arrival.
"""

from __future__ import annotations

import numpy as np
import pytest

from onboard.bus.schema import MocapPose, TickBatch
from onboard.bus.topics import Topic
from onboard.mocap.relay import latency
from sitl.emulator.mocap import MocapSettings


@pytest.mark.long
@pytest.mark.parametrize("latency_s", [pytest.param(0.02, marks=pytest.mark.long), 0.08])
def test_the_mocaps_latency_is_found_when_its_stamps_do_not_allow_for_it(
    lockstep, paper, latency_s: float
):
    flight = lockstep(paper, seed=1, mocap=MocapSettings(latency_s=latency_s))
    poses: dict[str, list] = {}
    ticks: dict[str, list] = {}

    def hear(topic, name, message) -> None:
        if isinstance(message, MocapPose):
            poses.setdefault(name, []).append(
                (flight.simulation.now_ns * 1e-9, message.quaternion_enu_flu_wxyz)
            )
        elif isinstance(message, TickBatch):
            ticks.setdefault(name, []).extend(
                (tick.stamp_ns * 1e-9 - tick.attitude_age_s, tick.attitude_quaternion_enu_flu_wxyz)
                for tick in message.ticks
            )

    node = flight.bus.node("ear")
    node.start()
    for topic in (Topic.MOCAP, Topic.TICK):
        node.subscribe(topic, "*", hear)
    flight.takeoff(1.0)
    for goal in ("0 0.6 1", "0 0 1"):
        flight.order(f"formation triangle {goal}")

    def curve(rows: list) -> tuple[np.ndarray, np.ndarray]:
        times = np.array([time_s for time_s, _ in rows])
        return times, latency.gravity([quaternion for _, quaternion in rows])

    for name in ("mav0", "mav1", "mav2"):
        found = latency.fit(*curve(poses[name]), *curve(ticks[name]))
        assert found is not None
        assert found.is_same
        assert found.lag_s == pytest.approx(latency_s, abs=0.015)
        for other in poses:
            if other != name:
                wrong = latency.fit(*curve(poses[other]), *curve(ticks[name]))
                assert wrong is None or wrong.correlation < found.correlation
