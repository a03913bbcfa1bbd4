"""The last check before a setpoint leaves: finite, bounded, and from a position and an attitude
that are known now.
"""

from __future__ import annotations

from onboard.agent.control_step import ControlStep
from onboard.agent_commands import Command, SendAttitude
from onboard.autopilot import Vec4
from onboard.config.fleet import Vehicle
from onboard.control.control_mode import ControlMode
from onboard.flight import state_machine
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightView
from onboard.localization.own_state import OwnState
from onboard.px4.required_params import required_params
from onboard.safety.failsafe_table import Action
from onboard.safety.limits import RECKONING_S
from onboard.safety.setpoint_check import is_sendable
from onboard.supervision.failsafe_executor import FailsafeExecutor

# PX4 speaks at least every 30 ms: setpoints are for an attitude that is known now, and a thread
# that hangs is not known
_PX4_FRESH_NS = 80_000_000
_RECKONED_S = RECKONING_S + 0.2


class SetpointOutput:
    """Decides at every tick which setpoint leaves, if any."""

    def __init__(
        self, vehicle: Vehicle, own: OwnState, flight: FlightContext, failsafes: FailsafeExecutor
    ) -> None:
        self.quaternion_wxyz: Vec4 = (1.0, 0.0, 0.0, 0.0)  # sent last, in the fleet frame
        self.sent_thrust_frac = 0.0  # sent last; 0 while nothing is sent
        self._own, self._flight, self._failsafes = own, flight, failsafes
        self._max_tilt_deg = vehicle.max_tilt_deg
        self._loss_ns = round(1e9 * float(required_params(vehicle).get("COM_OF_LOSS_T", 0.3)))
        self._sent_ns = 0

    def commands(self, view: FlightView, control: ControlStep) -> list[Command]:
        """Return the setpoint of this tick, or nothing: then PX4 sees silence."""
        flight, now_ns = self._flight, view.now_ns
        if not flight.step.is_streaming or control.tick is None:
            self.sent_thrust_frac, self._sent_ns = 0.0, 0
            return []
        if flight.must_be_offboard and self._sent_ns and now_ns - self._sent_ns > self._loss_ns:
            # PX4 has begun to land meanwhile: setpoints that come back now would take the vehicle
            # from it
            sentence = f"No setpoint has left for {self._loss_ns * 1e-9:.1f} s: PX4 lands."
            flight.say(view, "critical", "setpoints-interrupted", sentence)
            state_machine.begin_failsafe(flight, view, Action.PX4_LAND, sentence)
            self._failsafes.action = max(self._failsafes.action, Action.PX4_LAND)
            return []
        must_be_level = self._failsafes.must_be_level or not control.is_finite
        setpoint = (
            control.level()
            if flight.step.control_mode is not ControlMode.GROUND and must_be_level
            else control.tick.attitude
        )
        has_position = (
            flight.step.control_mode is ControlMode.GROUND or self._own.age_s < _RECKONED_S
        )
        is_fresh = has_position and now_ns - view.snapshot.last_packet_ns < _PX4_FRESH_NS
        for_px4 = self._own.to_px4(setpoint)
        # what leaves is checked: a quaternion of zeros ends the attitude control of PX4 v1.18 until
        # it restarts
        if not is_fresh or not is_sendable(for_px4, self._max_tilt_deg):
            return []
        self._sent_ns = now_ns
        self.quaternion_wxyz, self.sent_thrust_frac = setpoint.quaternion_wxyz, setpoint.thrust_frac
        return [SendAttitude(for_px4)]
