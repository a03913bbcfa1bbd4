"""The agents' links to the emulated PX4s, without MAVLink: typed values, but only what a client on the wire would see.

Telemetry comes at the rates that the agent asks for (attitude and local position at 50 Hz, landed state at 10 Hz,
battery at 2 Hz) and armed and mode once a second, with the heartbeat; everything takes ``delay_s``, both ways. Whether
a command did anything is only seen in what PX4 reports afterwards. Bytes would cost more than all the rest of the
flight; packing and unpacking them is tested by the emulator's and the real link's own tests.
"""

from __future__ import annotations

import heapq
import itertools
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from onboard.config import Vehicle
from onboard.frames import (
    ned_from_enu,
    quaternion_enu_flu_from_ned_frd,
    quaternion_multiply,
    quaternion_ned_frd_from_enu_flu,
)
from onboard.link import modes
from onboard.link.autopilot import Landed, Snapshot, Vec3, Vec4
from onboard.link.params import differences, required_params
from onboard.types import AttitudeSetpoint
from sitl.emulator import Emulator
from sitl.modes import MODES, Mode
from sitl.vehicle import STEP_S

_ATTITUDE_EVERY_STEPS, _ATTITUDE_PHASE_STEPS = 5, 3  # sampled 8 ms before the tick that uses it
_LANDED_EVERY_STEPS = 25
_BATTERY_EVERY_STEPS = 125
_HEARTBEAT_EVERY_STEPS = 250
_ATTITUDE_NOISE_RAD = np.radians([0.06, 0.06, 0.11])  # as the emulator has it on the wire
_TYPE_MASK_ATTITUDE_AND_THRUST = 7
_NO_RATES = [0.0, 0.0, 0.0]


class LinkBank:
    """The links of all vehicles.

    Args:
        emulator: the PX4s; vehicles: in the same order.
        now_ns: the simulated time. seed: of the noise of attitude.
        delay_s: from one end of a link to the other, rounded up to whole physics steps.
    """

    def __init__(
        self,
        emulator: Emulator,
        vehicles: Sequence[Vehicle],
        now_ns: Callable[[], int],
        *,
        seed: int,
        delay_s: float = 0.004,
    ) -> None:
        self.emulator, self.now_ns = emulator, now_ns
        self.links = [EmulatedLink(self, index, vehicle) for index, vehicle in enumerate(vehicles)]
        self._delay_steps = max(1, int(np.ceil(delay_s / STEP_S - 1e-9)))
        self._rng = np.random.default_rng([seed, 12])
        self._up: list[tuple[int, int, Callable[..., object], tuple[Any, ...]]] = []
        self._down: deque[tuple[int, list[dict[str, Any]]]] = deque()
        self._count = itertools.count()

    @property
    def _steps(self) -> int:
        return self.emulator.world.vehicles.steps

    def step(self) -> None:
        """Everything that arrives at this physics step, then what the PX4s send."""
        steps = self._steps
        while self._up and self._up[0][0] <= steps:
            _, _, function, args = heapq.heappop(self._up)
            function(*args)
        while self._down and self._down[0][0] <= steps:
            _, rows = self._down.popleft()
            for link, fields in zip(self.links, rows, strict=True):
                link.receive(fields)
        self._sample(steps)

    def send(self, index: int, function: Callable[..., object], *args: Any) -> None:
        """Call something at PX4's end when it gets there."""
        if not self.links[index].is_up_cut:
            heapq.heappush(self._up, (self._steps + self._delay_steps, next(self._count), function, args))

    def _sample(self, steps: int) -> None:
        if steps % _ATTITUDE_EVERY_STEPS != _ATTITUDE_PHASE_STEPS:
            return
        frame = steps - _ATTITUDE_PHASE_STEPS
        believed = np.array([self.emulator.believed_attitude(index) for index in range(len(self.links))])
        turn = _ATTITUDE_NOISE_RAD * self._rng.standard_normal((len(self.links), 3))
        small = np.concatenate([np.ones((len(turn), 1)), 0.5 * turn], axis=1)
        attitude = quaternion_multiply(believed, small / np.linalg.norm(small, axis=1, keepdims=True))
        quaternions = quaternion_enu_flu_from_ned_frd(attitude).tolist()
        boot_ms = round(self.emulator.time_s * 1e3)
        rows: list[dict[str, Any]] = []
        for index, quaternion in enumerate(quaternions):
            local = self.emulator.estimator.local(index)
            rows.append(
                {
                    "quaternion_enu_flu_wxyz": tuple(quaternion),
                    "px4_boot_ms": boot_ms,
                    "position_local_ned_m": local.position_ned_m,
                    "velocity_local_ned_m_s": local.velocity_ned_m_s,
                }
            )
        for every, sample in (
            (_LANDED_EVERY_STEPS, self._landed),
            (_BATTERY_EVERY_STEPS, self._battery),
            (_HEARTBEAT_EVERY_STEPS, self._heartbeat),
        ):
            if frame % every == 0:
                for index, row in enumerate(rows):
                    row.update(sample(index))
        self._down.append((steps + self._delay_steps, rows))

    def _landed(self, index: int) -> dict[str, Any]:
        return {"landed": Landed(int(self.emulator.autopilots[index].landed))}

    def _battery(self, index: int) -> dict[str, Any]:
        battery = self.emulator.autopilots[index].battery
        return {"battery_frac": battery.remaining_pct / 100.0, "battery_voltage_v": battery.voltage_mv / 1000.0}

    def _heartbeat(self, index: int) -> dict[str, Any]:
        autopilot = self.emulator.autopilots[index]
        return {
            "is_armed": autopilot.is_armed,
            "mode": modes.mode_name(MODES[autopilot.mode].custom_mode),
            "is_failsafe": int(autopilot.system_status(self.emulator.time_s)) == modes.STATUS_CRITICAL,
        }


class EmulatedLink:
    """One agent's link; an :class:`onboard.link.autopilot.Autopilot`."""

    def __init__(self, bank: LinkBank, index: int, vehicle: Vehicle) -> None:
        self.is_up_cut = self.is_down_cut = False
        self._bank, self._index, self._vehicle = bank, index, vehicle
        self._fields: dict[str, Any] = {"system_id": vehicle.system_id}
        self._snapshot: Snapshot | None = Snapshot()

    # -- in ----------------------------------------------------------------------------------------------------------

    def receive(self, fields: dict[str, Any]) -> None:
        """What PX4 sent has arrived."""
        if self.is_down_cut:
            return
        now_ns = self._bank.now_ns()
        known = self._fields
        known.update(fields)
        known["last_packet_ns"] = known["attitude_ns"] = known["local_position_ns"] = now_ns
        if "mode" in fields:
            known["heartbeat_ns"] = now_ns
        if "landed" in fields:
            known["landed_ns"] = now_ns
        self._snapshot = None

    def snapshot(self) -> Snapshot:
        """The newest values."""
        if self._snapshot is None:
            self._snapshot = Snapshot(**self._fields)
        return self._snapshot

    # -- out ---------------------------------------------------------------------------------------------------------

    def send_attitude(self, setpoint: AttitudeSetpoint) -> None:
        """SET_ATTITUDE_TARGET with attitude and thrust."""
        q = quaternion_ned_frd_from_enu_flu(np.asarray(setpoint.quaternion_wxyz, dtype=np.float64)).tolist()
        self._send(
            self._bank.emulator.attitude_setpoint,
            self._index,
            q,
            _NO_RATES,
            float(setpoint.thrust_frac),
            _TYPE_MASK_ATTITUDE_AND_THRUST,
        )

    def set_offboard(self) -> None:
        """DO_SET_MODE to OFFBOARD."""
        self._ask(lambda px4, now_s: px4.request_mode(now_s, modes.MAIN_MODE_OFFBOARD, 0))

    def land(self) -> None:
        """PX4's own landing."""
        self._ask(lambda px4, now_s: px4.request(now_s, Mode.LAND))

    def arm(self) -> None:
        """Ask to arm."""
        self._ask(lambda px4, now_s: px4.request_arm(now_s, True, 0.0))

    def disarm(self) -> None:
        """Ask to disarm."""
        self._ask(lambda px4, now_s: px4.request_arm(now_s, False, 0.0))

    def kill(self) -> None:
        """Disarm by force."""
        self._ask(lambda px4, now_s: px4.request_arm(now_s, False, modes.FORCE_DISARM_MAGIC))

    def send_odometry(self, position_enu_m: Vec3, quaternion_enu_flu_wxyz: Vec4, std_m: float) -> None:
        """ODOMETRY with the mocap's position."""
        position = ned_from_enu(np.asarray(position_enu_m, dtype=np.float64))
        self._send(self._bank.emulator.vision, self._index, position)

    def connect(self) -> tuple[str, ...]:
        """What the shell does when PX4 answers: origin and parameters; returns what is still wrong with these."""
        emulator, required = self._bank.emulator, required_params(self._vehicle)
        params = emulator.autopilots[self._index].params
        if self._vehicle.mocap_required:
            emulator.has_global_origin[self._index] = True
        for name, value in required.items():
            if name in params.values:
                params.values[name] = value
        emulator.parameters_changed(self._index)
        return differences(required, {name: params.values.get(name) for name in required})

    def _ask(self, command: Callable[[Any, float], object]) -> None:
        emulator, index = self._bank.emulator, self._index
        self._send(lambda: command(emulator.autopilots[index], emulator.time_s))

    def _send(self, function: Callable[..., object], *args: Any) -> None:
        self._bank.send(self._index, function, *args)
