"""The link on which viewers of PX4's simulator see the emulated vehicles: where it is, and what
they read there.
"""

from __future__ import annotations

import pytest

from sitl.mavlink.codec import Decoder
from sitl.mavlink.endpoints import simulator_ports
from sitl.mavlink.lossy_link import LossyLink
from sitl.mavlink.streams import SIMULATOR_RATES_HZ
from tests.sitl.sitl_flying import emulator, run_for


def test_the_simulator_link_has_the_ports_of_sih_and_none_outside_of_px4s_layout() -> None:
    first = simulator_ports("udpin://127.0.0.1:14540")
    late = simulator_ports("udpin://127.0.0.1:15552")
    assert first is not None
    assert late is not None
    assert (first.bind, first.peer) == (("127.0.0.1", 19450), ("127.0.0.1", 19410))
    assert (late.bind, late.peer) == (("127.0.0.1", 19462), ("127.0.0.1", 19422))
    outside = (
        "udpin://127.0.0.1:30000",
        "udpin://127.0.0.1:15590",
        "udpout://10.0.0.2:14540",
        "serial:///dev/ttyAMA0:921600",
    )
    assert [simulator_ports(endpoint) for endpoint in outside] == [None] * 4


def test_a_silent_viewer_receives_the_true_position_of_each_vehicle() -> None:
    emu = emulator((0.0, 0.0, 0.0), (3.0, 4.0, 0.0))
    links = [LossyLink(emu, index, SIMULATOR_RATES_HZ, "simulator") for index in range(2)]
    decoder = Decoder()
    seen: list[list] = [[], []]

    def poll() -> None:
        for link, messages in zip(links, seen, strict=True):
            messages.extend(
                m
                for frame in link.poll()
                for m in decoder.decode(frame)
                if m.name == "HIL_STATE_QUATERNION"
            )

    run_for(emu, 2.3, poll)
    assert [len(messages) for messages in seen] == [pytest.approx(50, abs=2)] * 2
    first, second = (messages[-1] for messages in seen)
    assert (first.system_id, second.system_id, second.fields["time_usec"]) == (1, 2, 0)
    assert second.fields["lat"] - first.fields["lat"] == pytest.approx(
        4.0 / 111_319.49 * 1e7, abs=2
    )
    assert second.fields["lon"] > first.fields["lon"]
