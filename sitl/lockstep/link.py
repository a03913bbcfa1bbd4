"""The agents' links to the emulated PX4s, without MAVLink: typed values, but only what a client on
the wire would see.

Telemetry comes at the rates that the agent asks for (attitude at 50 Hz, local position at 50 Hz or,
beside a motion capture, 10 Hz, landed state at 10 Hz, accuracy and satellites at 5 Hz, battery at 2
Hz) and armed and mode once a second, with the heartbeat; everything takes ``delay_s``, both ways.
Whether a command did anything is only seen in what PX4 reports afterwards. Bytes would cost more
than all the rest of the flight; packing and unpacking them is tested by the emulator's and the real
link's own tests.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from onboard.agent_inputs import ParamsRead
from onboard.autopilot import Landed, Snapshot, Vec3, Vec4
from onboard.config.fleet import Vehicle
from onboard.frames import (
    enu_flu_from_ned_frd,
    ned_frd_from_enu_flu,
    ned_from_enu,
    yaw_from_quaternion,
)
from onboard.px4 import modes
from onboard.px4.required_params import BATTERY_FLOOR, differences, required_params
from onboard.types import AttitudeSetpoint
from sitl.emulator.emulator import Emulator
from sitl.mavlink.view import HALF_NOISE_RAD, View, measured_attitude
from sitl.physics.vehicle import STEP_S
from sitl.px4.modes import MODES, Mode

_ATTITUDE_EVERY_STEPS, _ATTITUDE_PHASE_STEPS = 5, 3  # sampled 8 ms before the tick that uses it
_LANDED_EVERY_STEPS = 25
_CHECKED_POSITION_EVERY_STEPS = 25  # of who flies by a motion capture
_BATTERY_EVERY_STEPS = 125
_ACCURACY_EVERY_STEPS = 50
_HEARTBEAT_EVERY_STEPS = 250
_TYPE_MASK_ATTITUDE_AND_THRUST = 7
_NO_RATES = [0.0, 0.0, 0.0]

Fields = dict[str, Any]
Call = Callable[[], object]


class LinkBank:
    """The links of all vehicles; the emulator's faults of the companion link act on them.

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
        self._channels = [
            (link, channels["companion", "in"], channels["companion", "out"])
            for link, channels in zip(self.links, emulator.disturbances.wires, strict=True)
        ]
        self._up: deque[tuple[int, int, Call]] = deque()
        self._down: deque[tuple[int, list[Fields | None]]] = deque()

    @property
    def _steps(self) -> int:
        return self.emulator.world.vehicles.steps

    def step(self) -> None:
        """Everything that arrives at this physics step, then what the PX4s send."""
        steps, channels = self._steps, self._channels
        while self._up and self._up[0][0] <= steps:
            _, index, call = self._up.popleft()
            _, channel, _ = channels[index]
            if channel.is_clear:
                call()
            else:
                channel.push(self.emulator.time_s, cast(Any, call))
        while self._down and self._down[0][0] <= steps:
            _, rows = self._down.popleft()
            for index, fields in enumerate(rows):
                if fields is not None:
                    _, _, channel = channels[index]
                    if channel.is_clear:
                        self.links[index].receive(fields)
                    else:
                        channel.push(self.emulator.time_s, cast(Any, fields))
        self._release_delayed()
        if steps % _ATTITUDE_EVERY_STEPS == _ATTITUDE_PHASE_STEPS:
            self._sample(steps)

    def send(self, index: int, call: Call) -> None:
        """Call something at PX4's end when it gets there."""
        self._up.append((self._steps + self._delay_steps, index, call))

    def answer(self, index: int, fields: Fields) -> None:
        """Send what one agent has asked for."""
        rows: list[Fields | None] = [None] * len(self.links)
        rows[index] = fields
        self._down.append((self._steps + self._delay_steps, rows))

    def _release_delayed(self) -> None:
        """Deliver what arrives from channels that hold something back."""
        now_s = self.emulator.time_s
        for link, up, down in self._channels:
            if up.is_clear and down.is_clear:
                continue
            if not up.is_clear:
                for call in up.pop(now_s):
                    cast(Call, call)()
            if not down.is_clear:
                for fields in down.pop(now_s):
                    link.receive(cast(Fields, fields))

    def _sample(self, steps: int) -> None:
        emulator, count = self.emulator, len(self.links)
        frame = steps - _ATTITUDE_PHASE_STEPS
        turns = zip(
            emulator.world.vehicles.states.attitude.tolist(),
            emulator.estimator.yaw_error_rad.tolist(),
            (np.multiply(HALF_NOISE_RAD, self._rng.standard_normal((count, 3)))).tolist(),
            emulator.estimator.tilt_error_rad.tolist(),
            strict=True,
        )
        quaternions = [enu_flu_from_ned_frd(measured_attitude(*turn)) for turn in turns]
        rows: list[Fields | None] = [
            None
            if emulator.disturbances.is_hung[index]
            else {
                "quaternion_enu_flu_wxyz": quaternions[index],
                "px4_boot_ms": round(
                    (emulator.clock_s(index) - emulator.autopilots[index].boot_time_s) * 1e3
                ),
            }
            for index in range(count)
        ]
        self._positions(rows, has_checked=frame % _CHECKED_POSITION_EVERY_STEPS == 0)
        for every, sample in (
            (_LANDED_EVERY_STEPS, self._landed),
            (_ACCURACY_EVERY_STEPS, self._accuracy),
            (_BATTERY_EVERY_STEPS, self._battery),
            (_HEARTBEAT_EVERY_STEPS, self.heartbeat),
        ):
            if frame % every == 0:
                for index, row in enumerate(rows):
                    if row is not None:
                        row.update(sample(index))
        self._down.append((steps + self._delay_steps, rows))

    def _positions(self, rows: Sequence[Fields | None], *, has_checked: bool) -> None:
        """LOCAL_POSITION_NED of who flies by it, and of the others while ``has_checked``."""
        positions = self.emulator.estimator.position_ned_m.tolist()
        velocities = self.emulator.estimator.velocity_ned_m_s.tolist()
        for row, link, position, velocity in zip(
            rows, self.links, positions, velocities, strict=True
        ):
            if row is not None and (has_checked or not link.has_mocap):
                row["position_local_ned_m"] = tuple(position)
                row["velocity_local_ned_m_s"] = tuple(velocity)

    def _landed(self, index: int) -> Fields:
        return {"landed": Landed(int(self.emulator.autopilots[index].landed))}

    def _battery(self, index: int) -> Fields:
        battery = self.emulator.autopilots[index].battery
        return {
            "battery_frac": battery.remaining_pct / 100.0,
            "battery_voltage_v": battery.voltage_mv / 1000.0,
        }

    def _accuracy(self, index: int) -> Fields:
        """ESTIMATOR_STATUS, and of who flies by satellites GPS_RAW_INT."""
        estimator, now_s = self.emulator.estimator, self.emulator.time_s
        fields: Fields = {"position_accuracy_m": estimator.accuracy_m(index, now_s)}
        return (
            fields
            if self.links[index].has_mocap
            else fields | {"has_fix": estimator.sees_satellites(index, now_s)}
        )

    def heartbeat(self, index: int) -> Fields:
        """HEARTBEAT, and with it what PX4 sends as seldom."""
        autopilot, view = self.emulator.autopilots[index], View(self.emulator, index)
        origin = (*view.origin_deg, view.origin_altitude_m) if view.has_origin else None
        return {
            "global_origin": origin,
            "px4_version": autopilot.version.number,
            "is_armed": autopilot.is_armed,
            "mode": modes.mode_name(MODES[autopilot.mode].custom_mode),
            "is_failsafe": int(autopilot.system_status(self.emulator.clock_s(index)))
            == modes.STATUS_CRITICAL,
        }


class EmulatedLink:
    """One agent's link; an :class:`onboard.autopilot.Autopilot`."""

    def __init__(self, bank: LinkBank, index: int, vehicle: Vehicle) -> None:
        self._bank, self._index, self._vehicle = bank, index, vehicle
        self.has_mocap = vehicle.mocap_required
        self._fields: Fields = {"system_id": vehicle.system_id}
        self._snapshot: Snapshot | None = Snapshot()

    # -- in ----------------------------------------------------------------------------------------

    def receive(self, fields: Fields) -> None:
        """Take values that PX4 has sent."""
        now_ns = self._bank.now_ns()
        known = self._fields
        known.update(fields)
        known["last_packet_ns"] = now_ns
        if "px4_boot_ms" in fields:
            known["attitude_ns"] = now_ns
        if "position_local_ned_m" in fields:
            known["local_position_ns"] = now_ns
        if "mode" in fields:
            known["heartbeat_ns"] = now_ns
        if "landed" in fields:
            known["landed_ns"] = now_ns
        if "position_accuracy_m" in fields:
            known["position_accuracy_ns"] = now_ns
        if "has_fix" in fields:
            known["fix_ns"] = now_ns
        if "battery_frac" in fields:
            known["battery_ns"] = now_ns
        self._snapshot = None

    def snapshot(self) -> Snapshot:
        """The newest values."""
        if self._snapshot is None:
            self._snapshot = Snapshot(**self._fields)
        return self._snapshot

    # -- out ---------------------------------------------------------------------------------------

    def send_attitude(self, setpoint: AttitudeSetpoint) -> None:
        """SET_ATTITUDE_TARGET with attitude and thrust."""
        q = list(ned_frd_from_enu_flu(setpoint.quaternion_wxyz))
        thrust, take, index = (
            setpoint.thrust_frac,
            self._bank.emulator.attitude_setpoint,
            self._index,
        )
        self._bank.send(
            index, lambda: take(index, q, _NO_RATES, thrust, _TYPE_MASK_ATTITUDE_AND_THRUST)
        )

    def set_offboard(self) -> None:
        """DO_SET_MODE to OFFBOARD."""
        self._request(lambda px4, now_s: px4.request_mode(now_s, modes.MAIN_MODE_OFFBOARD, 0))

    def land(self) -> None:
        """PX4's own landing."""
        self._request(lambda px4, now_s: px4.request(now_s, Mode.LAND))

    def arm(self) -> None:
        """Ask to arm."""
        self._request(lambda px4, now_s: px4.request_arm(now_s, True, 0.0))

    def disarm(self) -> None:
        """Ask to disarm."""
        self._request(lambda px4, now_s: px4.request_arm(now_s, False, 0.0))

    def kill(self) -> None:
        """Disarm by force."""
        self._request(lambda px4, now_s: px4.request_arm(now_s, False, modes.FORCE_DISARM_MAGIC))

    def request_heartbeat(self) -> None:
        """REQUEST_MESSAGE of HEARTBEAT."""
        self._request(
            lambda px4, now_s: self._bank.answer(self._index, self._bank.heartbeat(self._index))
        )

    def play_tune(self) -> None:
        """Let it play a tune."""
        self._request(lambda px4, now_s: px4.play_tune())

    def send_odometry(
        self,
        position_enu_m: Vec3,
        quaternion_enu_flu_wxyz: Vec4,
        std_m: float,
        reset_count: int = 0,
    ) -> None:
        """ODOMETRY with the mocap's position and heading."""
        position_ned_m = np.array(ned_from_enu(position_enu_m))
        yaw_rad = yaw_from_quaternion(ned_frd_from_enu_flu(quaternion_enu_flu_wxyz))
        take, index = self._bank.emulator.vision, self._index
        self._bank.send(
            index, lambda: take(index, position_ned_m, yaw_rad=yaw_rad, reset_count=reset_count)
        )

    def connect(self) -> ParamsRead:
        """Set origin and parameters, as the shell does when PX4 answers; return what it reads then."""
        emulator = self._bank.emulator
        params = emulator.autopilots[self._index].params
        required = required_params(self._vehicle, params.version.number)
        if self._vehicle.mocap_required:
            emulator.has_global_origin[self._index] = True
        for name, value in required.items():
            if name in params.values:
                params.values[name] = value
        emulator.parameters_changed(self._index)
        problems = differences(required, {name: params.values.get(name) for name in required})
        return ParamsRead(problems, 0.01 * params[BATTERY_FLOOR])

    def _request(self, command: Callable[[Any, float], object]) -> None:
        emulator, index = self._bank.emulator, self._index

        def request() -> None:
            if not emulator.disturbances.is_hung[index]:
                command(emulator.autopilots[index], emulator.clock_s(index))

        self._bank.send(index, request)
