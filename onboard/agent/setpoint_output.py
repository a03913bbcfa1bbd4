"""The last check of a setpoint before it is sent to PX4.

A setpoint is sent only if it is finite and bounded, and only if position and attitude are known at
this tick. Otherwise nothing is sent. After COM_OF_LOSS_T without setpoints, PX4 lands.
"""

from __future__ import annotations

from onboard.agent.control_step import ControlStep
from onboard.agent_commands import Command, SendAttitude
from onboard.config.fleet import Vehicle
from onboard.control.control_mode import ControlMode
from onboard.flight import state_machine
from onboard.flight.context import FlightContext
from onboard.flight.types import MUST_BE_OFFBOARD, FlightStep, FlightView
from onboard.frames import body_up
from onboard.localization.own_state import OwnState
from onboard.px4.required_params import silence_s
from onboard.safety.failsafe_table import Action
from onboard.safety.limits import RECKONING_AMONG_OTHERS_S
from onboard.safety.setpoint_check import is_sendable
from onboard.supervision.failsafe_supervisor import FailsafeSupervisor
from onboard.tuples import Wxyz
from onboard.types import AttitudeSetpoint

# PX4 sends a packet at least every 30 ms. If none has come for longer than this, PX4 or a thread
# hangs, and the attitude is unknown.
_PX4_FRESH_NS = 80_000_000
# setpoints are sent for at most this time of dead reckoning; the failsafe ends it earlier
_RECKONED_S = RECKONING_AMONG_OTHERS_S + 0.2

_LEANS_COS = 0.99  # on the ground, a tilt beyond 8 degrees means leaning against the wind


class SetpointOutput:
    """Decides at every tick which setpoint is sent, if any."""

    def __init__(
        self, vehicle: Vehicle, own: OwnState, flight: FlightContext, failsafes: FailsafeSupervisor
    ) -> None:
        self.quaternion_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)  # last one sent, in the fleet frame
        self.sent_thrust_frac = 0.0  # last throttle sent; 0 while nothing is sent
        self._own = own
        self._flight = flight
        self._failsafes = failsafes
        self._max_tilt_deg = vehicle.max_tilt_deg
        self._has_mocap = vehicle.mocap_required
        # after this time without setpoints, PX4 begins to land
        self._loss_ns = round(1e9 * silence_s(vehicle))
        self._sent_ns = 0  # time of the last setpoint; 0 while nothing is sent
        # time, attitude and throttle of the setpoint before the last one
        self._before: tuple[int, Wxyz, float] = (0, self.quaternion_wxyz, 0.0)

    @property
    def sent_lift_frac(self) -> float:
        """Vertical part of the last throttle sent."""
        return self.sent_thrust_frac * body_up(self.quaternion_wxyz).z

    def commands(self, view: FlightView, control: ControlStep) -> list[Command]:
        """Return the command with this tick's setpoint; empty if none may be sent."""
        step = self._flight.step
        if not step.is_streaming or control.tick is None:
            self.sent_thrust_frac = 0.0
            self._sent_ns = 0
            return []

        silence_ns = 0
        if self._sent_ns:
            silence_ns = view.now_ns - self._sent_ns
        if silence_ns > self._loss_ns and step in MUST_BE_OFFBOARD:
            self._let_px4_land(view)
            return []

        is_on_ground = step.control_mode is ControlMode.GROUND
        setpoint = control.tick.attitude
        must_be_level = self._failsafes.must_be_level or not control.is_finite
        if must_be_level and not is_on_ground:
            setpoint = control.level()

        if step is FlightStep.DESCENT and self._may_hop(view):
            setpoint = _without_hop(setpoint, control.hover_frac)

        has_position = is_on_ground or view.position_age_s < _RECKONED_S
        has_attitude = view.now_ns - view.snapshot.last_packet_ns < _PX4_FRESH_NS
        if not has_position or not has_attitude:
            return []

        # The converted setpoint is checked exactly as it is sent, because a quaternion of zeros
        # stops the attitude control of PX4 v1.18 until PX4 restarts.
        for_px4 = self._own.to_px4(setpoint)
        if not is_sendable(for_px4, self._max_tilt_deg):
            return []

        self._before = (self._sent_ns, self.quaternion_wxyz, self.sent_thrust_frac)
        self._sent_ns = view.now_ns
        self.quaternion_wxyz = setpoint.quaternion_wxyz
        self.sent_thrust_frac = setpoint.thrust_frac
        return [SendAttitude(for_px4)]

    def forget_last(self) -> None:
        """Count the last setpoint as not sent, because it was too old when it was ready."""
        self._sent_ns, self.quaternion_wxyz, self.sent_thrust_frac = self._before

    def _may_hop(self, view: FlightView) -> bool:
        """Return whether the vehicle may touch the ground; False if its height is not accurate."""
        is_height_exact = self._has_mocap and not view.is_dead_reckoned
        return is_height_exact and self._flight.may_touch_the_ground(view)

    def _let_px4_land(self, view: FlightView) -> None:
        """Leave the vehicle to PX4, which has started to land because setpoints were missing.

        New setpoints would interrupt PX4's landing.
        """
        sentence = f"No setpoint has left for {self._loss_ns * 1e-9:.1f} s: PX4 lands."
        self._flight.say(view, "critical", "setpoints-interrupted", sentence)
        state_machine.begin_failsafe(self._flight, view, Action.PX4_LAND, sentence)
        self._failsafes.action = max(self._failsafes.action, Action.PX4_LAND)


def _without_hop(setpoint: AttitudeSetpoint, hover_frac: float) -> AttitudeSetpoint:
    """Return the setpoint with a throttle that does not lift a vehicle off the ground.

    The ground levels a vehicle that leans against the wind. A throttle that carries the leaning
    vehicle would lift it again once it is level, and the wind would carry it along the ground. So
    the limit is lower the more the vehicle leans. A vehicle that hardly leans may brake its
    touchdown with full throttle.
    """
    _, _, cos_tilt = body_up(setpoint.quaternion_wxyz)
    if cos_tilt > _LEANS_COS:
        return setpoint
    largest_frac = hover_frac * cos_tilt
    return setpoint._replace(thrust_frac=min(setpoint.thrust_frac, largest_frac))
