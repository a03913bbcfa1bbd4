"""The tune that identifies a vehicle, from the agent's link through a real socket to the emulator's
ear.
"""

from __future__ import annotations

import socket
import threading
import time

from pymavlink.dialects.v20 import common

from onboard.px4.mavsdk_link import Px4Link
from tests.onboard.px4.test_px4_link import free_pair
from tests.sitl.sitl_flying import Client, emulator


def test_a_tune_reaches_px4_as_mavlink_says_and_the_emulator_counts_it() -> None:
    port = free_pair()
    px4 = common.MAVLink(None, srcSystem=1, srcComponent=1)
    heard: list[bytes] = []
    is_over = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
        wire.settimeout(0.05)

        def be_px4() -> None:
            while not is_over.is_set():
                beat = px4.heartbeat_encode(2, 12, 81, 50593792, 3)
                wire.sendto(beat.pack(px4), ("127.0.0.1", port))
                try:
                    heard.append(wire.recv(2048))
                except TimeoutError:
                    continue

        thread = threading.Thread(target=be_px4)
        thread.start()
        link = Px4Link(f"udpin://127.0.0.1:{port}", 1)
        try:
            link.start()
            assert any(link.connect(1.0) for _ in range(30))
            link.play_tune()
            end_s = time.monotonic() + 10.0
            tunes: list[bytes] = []
            while not tunes and time.monotonic() < end_s:
                time.sleep(0.05)
                tunes = [
                    one for one in list(heard) if one[0] == 0xFD and one[7:10] == bytes((2, 1, 0))
                ]
            assert tunes, "no PLAY_TUNE (258) came"
        finally:
            is_over.set()
            thread.join()
            link.stop()
    (message,) = common.MAVLink(None).parse_buffer(bytearray(tunes[0]))
    assert (message.target_system, message.target_component) == (1, 1)
    assert message.tune.startswith("MFT180")
    assert len(message.tune) < 30
    emu = emulator()
    Client(emu).link.receive(tunes[0])
    assert emu.autopilots[0].tunes == 1
