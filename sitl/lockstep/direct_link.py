"""The agents' links to the emulated PX4s: the values of MAVLink messages, without their bytes.

Telemetry comes at the rates that the agent requests: attitude at 50 Hz; local position at 50 Hz, or
at 10 Hz for a vehicle with motion capture; landed state at 10 Hz; accuracy, satellites and sticks
at 5 Hz; battery at 2 Hz; armed and mode once a second, with the heartbeat. Every message takes
``delay_s``, in both directions. Commands return nothing. Only later reports from PX4 show their
effect.

PX4's ground link carries only the ground's direct commands and their answers, as calls. Without
faults they arrive at once.

Packing and unpacking bytes would take longer than the rest of the flight. The tests of the emulator
and of the real link cover it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np

from onboard.agent_inputs import ParamsRead
from onboard.autopilot import Landed, Snapshot
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.frames import (
    enu_flu_from_ned_frd,
    ned_frd_from_enu_flu,
    ned_from_enu,
    yaw_from_quaternion,
)
from onboard.px4 import modes
from onboard.px4.required_params import BATTERY_FLOOR, differences, required_params, unmet
from onboard.tuples import Wxyz, Xyz
from onboard.types import AttitudeSetpoint
from sitl.emulator.emulator import Emulator
from sitl.faults.lossy_channel import LossyChannel
from sitl.mavlink.view import HALF_NOISE_RAD, View, measured_attitude
from sitl.physics.random_streams import Stream
from sitl.physics.vehicle import STEP_S
from sitl.px4.modes import MODES, Mode
from sitl.px4.satellite_receiver import ACCURACIES_M

# attitude is sampled 8 ms before the tick that uses it
_ATTITUDE_EVERY_STEPS = 5
_ATTITUDE_PHASE_STEPS = 3

_LANDED_EVERY_STEPS = 25
# local position of vehicles with motion capture, whose agents compare it with the poses
_MOCAP_POSITION_EVERY_STEPS = 25
_BATTERY_EVERY_STEPS = 125
_ACCURACY_EVERY_STEPS = 50
_HEARTBEAT_EVERY_STEPS = 250
_STICKS_EVERY_STEPS = 50
_ATTITUDES_PER_HEARTBEAT = _HEARTBEAT_EVERY_STEPS // _ATTITUDE_EVERY_STEPS

_TYPE_MASK_ATTITUDE_AND_THRUST = 7
_NO_RATES = [0.0, 0.0, 0.0]

# some fields of a Snapshot: name -> value
Fields = dict[str, Any]

# a call that acts on the emulated PX4
Px4Call = Callable[[], object]

# Snapshot field with the time of arrival of a message -> a field that comes in this message
_TIMES = {
    "attitude_ns": "px4_boot_ms",
    "local_position_ns": "position_local_ned_m",
    "heartbeat_ns": "mode",
    "landed_ns": "landed",
    "position_accuracy_ns": "position_accuracy_m",
    "fix_ns": "has_fix",
    "sticks_ns": "sticks_ns",
    "battery_ns": "battery_frac",
}


class _Ends(NamedTuple):
    """A link and its two channels, which the emulator's faults can disturb.

    The channels are typed for bytes. Here they carry calls and fields instead. This works because a
    channel never reads the messages that it passes on.
    """

    link: EmulatedLink
    up: LossyChannel[bytes]  # to PX4
    down: LossyChannel[bytes]  # to the agent


class _GroundWires(NamedTuple):
    """The two channels of a ground link, which carry calls."""

    up: LossyChannel[bytes]  # to PX4
    down: LossyChannel[bytes]  # to the ground


class LinkBank:
    """The links of all vehicles; the emulator's faults of both links act on them.

    Args:
        emulator: the emulator with all PX4s.
        fleet: the fleet file.
        vehicles: the vehicles in the order of the emulator's PX4s.
        now_ns: returns the simulated time.
        seed: the seed of the attitude noise.
        delay_s: time from one end of a link to the other, rounded up to whole physics steps.
    """

    def __init__(
        self,
        emulator: Emulator,
        fleet: FleetConfig,
        vehicles: Sequence[Vehicle],
        now_ns: Callable[[], int],
        *,
        seed: int,
        delay_s: float = 0.004,
    ) -> None:
        self.emulator = emulator
        self.fleet = fleet
        self.now_ns = now_ns
        self.links = [EmulatedLink(self, index, vehicle) for index, vehicle in enumerate(vehicles)]
        # 1e-9 keeps a rounding error from adding a step
        self._delay_steps = max(1, int(np.ceil(delay_s / STEP_S - 1e-9)))
        self._rng = np.random.default_rng([seed, Stream.DIRECT_LINK])

        # The PX4s are switched on at different moments, so they also send at different moments.
        phase_rng = np.random.default_rng([seed, Stream.SWITCHED_ON])
        phases = phase_rng.integers(_ATTITUDES_PER_HEARTBEAT, size=len(vehicles))
        self._phase_steps: list[int] = (_ATTITUDE_EVERY_STEPS * phases).tolist()

        # the emulator's faults make these channels delay or lose messages
        self._ends = [
            _Ends(link, channels["companion", "in"], channels["companion", "out"])
            for link, channels in zip(self.links, emulator.disturbances.wires, strict=True)
        ]
        self._ground_wires = [
            _GroundWires(channels["ground", "in"], channels["ground", "out"])
            for channels in emulator.disturbances.wires
        ]

        # messages on their way, each with the physics step at which it arrives: calls to the PX4 of
        # one vehicle (step, index, call), and fields for the agents of all vehicles (step, rows)
        self._calls: deque[tuple[int, int, Px4Call]] = deque()
        self._rows: deque[tuple[int, list[Fields | None]]] = deque()

    @property
    def _steps(self) -> int:
        return self.emulator.world.vehicles.steps

    def step(self) -> None:
        """Deliver what arrives at this physics step, then send what the PX4s report."""
        steps = self._steps
        self._deliver_calls(steps)
        self._deliver_rows(steps)
        self._release_delayed()
        if steps % _ATTITUDE_EVERY_STEPS == _ATTITUDE_PHASE_STEPS:
            self._sample(steps)

    def send(self, index: int, call: Px4Call) -> None:
        """Send a call to one vehicle's PX4, where it is made after the delay."""
        self._calls.append((self._steps + self._delay_steps, index, call))

    def answer(self, index: int, fields: Fields) -> None:
        """Send one agent the fields that it has requested."""
        rows: list[Fields | None] = [None] * len(self.links)
        rows[index] = fields
        self._rows.append((self._steps + self._delay_steps, rows))

    def send_from_ground(self, index: int, call: Px4Call) -> None:
        """Send a call of the ground to one vehicle's PX4, over its ground link."""
        self._pass_on(self._ground_wires[index].up, call)

    def answer_ground(self, index: int, call: Callable[[], object]) -> None:
        """Send a call of one vehicle's PX4 to the ground, over its ground link."""
        self._pass_on(self._ground_wires[index].down, call)

    def _pass_on(self, channel: LossyChannel[bytes], call: Callable[[], object]) -> None:
        """Make a call now, or send it through a channel that is disturbed."""
        if channel.is_clear:
            call()
        else:
            channel.push(self.emulator.time_s, cast(Any, call))

    def _deliver_calls(self, steps: int) -> None:
        while self._calls:
            due_steps, index, call = self._calls[0]
            if due_steps > steps:
                return
            self._calls.popleft()
            self._pass_on(self._ends[index].up, call)

    def _deliver_rows(self, steps: int) -> None:
        while self._rows:
            due_steps, rows = self._rows[0]
            if due_steps > steps:
                return
            self._rows.popleft()
            for ends, fields in zip(self._ends, rows, strict=True):
                if fields is None:
                    continue
                if ends.down.is_clear:
                    ends.link.receive(fields)
                else:
                    ends.down.push(self.emulator.time_s, cast(Any, fields))

    def _release_delayed(self) -> None:
        """Deliver messages that a disturbed channel has held back until now."""
        now_s = self.emulator.time_s
        for ends in self._ends:
            if not ends.up.is_clear:
                for call in ends.up.pop(now_s):
                    cast(Px4Call, call)()
            if not ends.down.is_clear:
                for fields in ends.down.pop(now_s):
                    ends.link.receive(cast(Fields, fields))
        for wires in self._ground_wires:
            for channel in wires:
                if not channel.is_clear:
                    for call in channel.pop(now_s):
                        cast(Px4Call, call)()

    def _sample(self, steps: int) -> None:
        """Send the due reports of all PX4s; a hung PX4 sends nothing."""
        since_first_steps = steps - _ATTITUDE_PHASE_STEPS  # since the first attitudes

        rows: list[Fields | None] = []
        for index, quaternion in enumerate(self._measured_attitudes()):
            if self.emulator.disturbances.is_hung[index]:
                rows.append(None)
            else:
                rows.append(
                    {
                        "quaternion_enu_flu_wxyz": quaternion,
                        "px4_boot_ms": self._boot_ms(index),
                    }
                )

        self._add_positions(rows, of_all=since_first_steps % _MOCAP_POSITION_EVERY_STEPS == 0)
        for every_steps, sample in (
            (_LANDED_EVERY_STEPS, self._landed),
            (_ACCURACY_EVERY_STEPS, self._accuracy),
            (_BATTERY_EVERY_STEPS, self._battery),
            (_STICKS_EVERY_STEPS, self._sticks),
            (_HEARTBEAT_EVERY_STEPS, self.heartbeat),
        ):
            for index, row in enumerate(rows):
                is_first = since_first_steps == 0  # then every PX4 sends everything
                is_due = (since_first_steps + self._phase_steps[index]) % every_steps == 0
                if row is not None and (is_first or is_due):
                    row.update(sample(index))

        self._rows.append((steps + self._delay_steps, rows))

    def _measured_attitudes(self) -> list[Wxyz]:
        """Return the attitudes of all vehicles (ENU, FLU) as their PX4s measure them."""
        estimator = self.emulator.estimator
        count = len(self.links)
        noise_rad = np.multiply(HALF_NOISE_RAD, self._rng.standard_normal((count, 3)))

        measured = map(
            measured_attitude,
            self.emulator.world.vehicles.states.attitude.tolist(),
            estimator.yaw_error_rad.tolist(),
            noise_rad.tolist(),
            estimator.tilt_error_rad.tolist(),
        )
        return [enu_flu_from_ned_frd(quaternion) for quaternion in measured]

    def _boot_ms(self, index: int) -> int:
        """Return the time [ms] since a PX4 booted, by its own clock."""
        up_s = self.emulator.clock_s(index) - self.emulator.autopilots[index].boot_time_s
        return round(up_s * 1e3)

    def _add_positions(self, rows: Sequence[Fields | None], *, of_all: bool) -> None:
        """Add LOCAL_POSITION_NED to the rows of all vehicles, or of those without motion capture.

        Args:
            rows: the fields that each vehicle's PX4 sends.
            of_all: whether vehicles with motion capture are included.
        """
        positions = self.emulator.estimator.position_ned_m.tolist()
        velocities = self.emulator.estimator.velocity_ned_m_s.tolist()
        for row, link, position, velocity in zip(
            rows, self.links, positions, velocities, strict=True
        ):
            if row is not None and (of_all or not link.has_mocap):
                row["position_local_ned_m"] = tuple(position)
                row["velocity_local_ned_m_s"] = tuple(velocity)

    def _landed(self, index: int) -> Fields:
        """Return EXTENDED_SYS_STATE."""
        return {"landed": Landed(int(self.emulator.autopilots[index].landed))}

    def _battery(self, index: int) -> Fields:
        """Return BATTERY_STATUS."""
        battery = self.emulator.autopilots[index].battery
        return {
            "battery_frac": battery.remaining_pct / 100.0,
            "battery_voltage_v": battery.voltage_mv / 1000.0,
        }

    def _sticks(self, index: int) -> Fields:
        """Return MANUAL_CONTROL; PX4 sends it only while a transmitter sends stick positions."""
        if not self.emulator.autopilots[index].has_sticks(self.emulator.clock_s(index)):
            return {}
        return {"sticks_ns": self.now_ns()}

    def _accuracy(self, index: int) -> Fields:
        """Return ESTIMATOR_STATUS, and GPS_RAW_INT of a vehicle without motion capture."""
        estimator = self.emulator.estimator
        now_s = self.emulator.time_s

        accuracy_m = estimator.accuracy_m(index, now_s)
        fields: Fields = {
            "is_position_known": estimator.is_position_known(index, now_s),
            "position_ratio": estimator.position_ratio(index),
            "heading_ratio": estimator.heading_ratio(index),
            "position_accuracy_m": accuracy_m,
            "height_accuracy_m": accuracy_m,
        }
        if not self.links[index].has_mocap:
            fix_type = self.emulator.fix_type(index)
            fields["has_fix"] = estimator.sees_satellites(index, now_s)
            fields["fix_type"] = fix_type
            fields["satellites"] = 0
            if fields["has_fix"]:
                fields["satellites"] = 10
            fields["fix_accuracy_m"] = ACCURACIES_M[fix_type]
        return fields

    def heartbeat(self, index: int) -> Fields:
        """Return HEARTBEAT, GPS_GLOBAL_ORIGIN and AUTOPILOT_VERSION."""
        autopilot = self.emulator.autopilots[index]
        view = View(self.emulator, index)

        origin = None
        if view.has_origin:
            origin = (*view.origin_deg, view.origin_altitude_m)
        status = int(autopilot.system_status(self.emulator.clock_s(index)))

        return {
            "global_origin": origin,
            "px4_version": autopilot.version.number,
            "is_armed": autopilot.is_armed,
            "mode": modes.mode_name(MODES[autopilot.shown_mode].custom_mode),
            "is_failsafe": status in modes.FAILSAFE_STATUSES,
        }


class EmulatedLink:
    """One agent's link to its PX4; implements :class:`onboard.autopilot.Autopilot`."""

    def __init__(self, bank: LinkBank, index: int, vehicle: Vehicle) -> None:
        self._bank = bank
        self._index = index
        self._vehicle = vehicle
        self.has_mocap = vehicle.mocap_required

        # the newest values, and a snapshot of them; None if newer values have arrived since
        self._fields: Fields = {"system_id": vehicle.system_id}
        self._snapshot: Snapshot | None = Snapshot()

    # -- in ----------------------------------------------------------------------------------------

    def receive(self, fields: Fields) -> None:
        """Store values that PX4 has sent."""
        now_ns = self._bank.now_ns()
        known = self._fields
        if "sticks_ns" in fields:
            known["sticks_before_ns"] = known.get("sticks_ns", 0)
        known.update(fields)

        known["last_packet_ns"] = now_ns
        for time_field, field in _TIMES.items():
            if field in fields:
                known[time_field] = now_ns

        self._snapshot = None

    def snapshot(self) -> Snapshot:
        """Return the newest values."""
        if self._snapshot is None:
            self._snapshot = Snapshot(**self._fields)
        return self._snapshot

    # -- out ---------------------------------------------------------------------------------------

    def send_attitude(self, setpoint: AttitudeSetpoint) -> None:
        """Send SET_ATTITUDE_TARGET with attitude and thrust."""
        take = self._bank.emulator.attitude_setpoint
        index = self._index
        quaternion_ned_frd = list(ned_frd_from_enu_flu(setpoint.quaternion_wxyz))
        thrust_frac = setpoint.thrust_frac

        def arrive() -> None:
            take(index, quaternion_ned_frd, _NO_RATES, thrust_frac, _TYPE_MASK_ATTITUDE_AND_THRUST)

        self._bank.send(index, arrive)

    def set_offboard(self) -> None:
        """Send DO_SET_MODE to OFFBOARD."""
        self._request(lambda px4, now_s: px4.request_mode(now_s, modes.MAIN_MODE_OFFBOARD, 0))

    def land(self) -> None:
        """Command PX4 to land by itself."""
        self._request(lambda px4, now_s: px4.request(now_s, Mode.LAND))

    def arm(self) -> None:
        """Ask to arm."""
        self._request(lambda px4, now_s: px4.request_arm(now_s, arm=True, magic=0.0))

    def disarm(self) -> None:
        """Ask to disarm."""
        self._request(lambda px4, now_s: px4.request_arm(now_s, arm=False, magic=0.0))

    def kill(self) -> None:
        """Disarm by force."""
        force = modes.FORCE_DISARM_MAGIC
        self._request(lambda px4, now_s: px4.request_arm(now_s, arm=False, magic=force))

    def request_heartbeat(self) -> None:
        """Send REQUEST_MESSAGE for HEARTBEAT."""

        def send_heartbeat(px4: Any, now_s: float) -> None:
            self._bank.answer(self._index, self._bank.heartbeat(self._index))

        self._request(send_heartbeat)

    def reboot(self) -> None:
        """Send PREFLIGHT_REBOOT_SHUTDOWN, which PX4 refuses while it is armed."""

        def reboot_px4(px4: Any, now_s: float) -> None:
            if not px4.is_armed:
                self._bank.emulator.reboot(self._index)

        self._request(reboot_px4)

    def play_tune(self) -> None:
        """Ask PX4 to play a tune."""
        self._request(lambda px4, now_s: px4.play_tune())

    def send_corrections(self, flags: int, data: bytes) -> None:
        """Send GPS_RTCM_DATA with a fragment of an RTCM frame."""
        take = self._bank.emulator.corrections
        index = self._index
        self._bank.send(index, lambda: take(index, flags, data))

    def send_odometry(
        self,
        position_enu_m: Xyz,
        quaternion_enu_flu_wxyz: Wxyz,
        std_m: float,
        reset_count: int = 0,
    ) -> None:
        """Send ODOMETRY with position and heading of the motion capture."""
        take = self._bank.emulator.vision
        index = self._index
        position_ned_m = np.array(ned_from_enu(position_enu_m))
        yaw_rad = yaw_from_quaternion(ned_frd_from_enu_flu(quaternion_enu_flu_wxyz))

        def arrive() -> None:
            take(index, position_ned_m, yaw_rad=yaw_rad, reset_count=reset_count)

        self._bank.send(index, arrive)

    def connect(self) -> ParamsRead:
        """Set origin and required parameters, as a real link does when it connects.

        Returns:
            PX4's parameters afterwards.
        """
        emulator = self._bank.emulator
        params = emulator.autopilots[self._index].params
        version = params.version.number
        required = required_params(self._bank.fleet, self._vehicle, version).values()

        if self._vehicle.mocap_required:
            emulator.has_global_origin[self._index] = True

        for demand in unmet(required, params.values):
            params.values[demand.name] = demand.value
        emulator.parameters_changed(self._index)

        actual = {demand.name: params.values.get(demand.name) for demand in required}
        return ParamsRead(differences(required, actual), 0.01 * params[BATTERY_FLOOR])

    def _request(self, command: Callable[[Any, float], object]) -> None:
        """Send a command to PX4, which executes it on arrival unless it hangs."""
        emulator = self._bank.emulator
        index = self._index

        def arrive() -> None:
            if not emulator.disturbances.is_hung[index]:
                command(emulator.autopilots[index], emulator.clock_s(index))

        self._bank.send(index, arrive)
