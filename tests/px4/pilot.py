"""A pilot beside a flight of real PX4s: a ground station's joystick, on PX4's ground link."""

from __future__ import annotations

import threading
import time
from types import TracebackType

from pymavlink import mavutil

_GROUND = (255, 190)  # system and component, as QGroundControl's
_HZ = 20.0
_SET_MODE = 176
_CUSTOM = 1.0  # of base_mode: the main mode counts
POSCTL = 3.0  # PX4's main mode
_MIDDLE = 500  # of the throttle, 0 to 1000


class Pilot:
    """Holds the sticks of one vehicle in their middle, 20 times a second, until its block ends.

    Args:
        direct: PX4's ground link, as in the fleet file.
        system_id: of that PX4.
    """

    def __init__(self, direct: str, system_id: int) -> None:
        address = direct.replace("udpout://", "udpout:")
        system, component = _GROUND
        self._link = mavutil.mavlink_connection(
            address, source_system=system, source_component=component
        )
        self._system_id = system_id
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._hold, daemon=True)

    def __enter__(self) -> Pilot:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._is_over.set()
        self._thread.join(2.0)
        self._link.close()

    def take(self, main_mode: float = POSCTL) -> None:
        """Switch the vehicle to a mode of the pilot's."""
        for _ in range(3):
            self._link.mav.command_long_send(
                self._system_id, 1, _SET_MODE, 0, _CUSTOM, main_mode, 0, 0, 0, 0, 0
            )
            time.sleep(0.05)

    def _hold(self) -> None:
        count = 0
        while not self._is_over.wait(1.0 / _HZ):
            if count % int(_HZ) == 0:
                self._link.mav.heartbeat_send(6, 8, 0, 0, 0)
            count += 1
            self._link.mav.manual_control_send(self._system_id, 0, 0, _MIDDLE, 0, 0)
