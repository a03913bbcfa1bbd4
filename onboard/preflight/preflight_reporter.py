"""The preflight check of one vehicle on the ground: gathers facts, checks them, and reports.

The core calls :meth:`PreflightReporter.update` at each tick on the ground, and publishes the report
of :meth:`PreflightReporter.due` once a second.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from onboard.agent_inputs import AgentInput
from onboard.autopilot import FIX_KNOWN_NS, Snapshot
from onboard.bus.schema import PreflightReport
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.corrections.status import CorrectionsStatus
from onboard.flight import takeover
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightStep, FlightView
from onboard.frames import enu_from_ned
from onboard.localization.own_state import OwnState
from onboard.neighbours.table import NeighbourTable
from onboard.preflight import all_rules
from onboard.preflight.attitude_comparison import AttitudeRate, TiltComparison
from onboard.preflight.law_refusals import LawRefusals
from onboard.preflight.preflight_facts import PreflightFacts
from onboard.preflight.preflight_inputs import PreflightInputs
from onboard.preflight.state_ages import StateAges
from onboard.px4.required_params import FUSES_HEADING, FUSES_POSITION, required_params
from onboard.px4.sensor_status import has_rc, unhealthy
from onboard.safety.failsafe_table import Condition
from onboard.safety.limits import POSITION_STALE_S
from onboard.safety.snapshot_check import nonsense
from onboard.tuples import Xyz
from onboard.types import TICK_S

_REPORT_EVERY_NS = 1_000_000_000
_JUDGE_EVERY_NS = 90_000_000  # every fifth tick, because a check takes 0.1 ms
_AT_REST_NS = 1_000_000_000  # the highest speed is taken over this time
_DROPPED_LATELY_S = 1.0  # impossible numbers of PX4 count for this time
_BEFORE_FLIGHT = frozenset(("waiting", "ready", "armed"))


class PreflightReporter:
    """Checks before a take-off whether one vehicle may fly."""

    def __init__(
        self,
        fleet: FleetConfig,
        vehicle: Vehicle,
        *,
        boot_id: int,
        own: OwnState,
        neighbours: NeighbourTable,
        flight: FlightContext,
    ) -> None:
        self._fleet = fleet
        self._vehicle = vehicle
        self._own = own
        self._neighbours = neighbours
        self._flight = flight
        self._config_hash = fleet.config_hash
        self._fused = 0  # bits of EKF2_EV_CTRL: which of the mocap's values PX4 uses
        if vehicle.mocap_required:
            self._fused = int(required_params(fleet, vehicle)["EKF2_EV_CTRL"].value)

        self.inputs = PreflightInputs(vehicle.name, vehicle.body, boot_id)
        self._attitude = AttitudeRate()
        self._tilt = TiltComparison()
        self._refusals = LawRefusals(fleet, vehicle.name, neighbours)
        self._state_ages = StateAges(fleet.state_ticks * TICK_S)

        self.not_ready: tuple[str, ...] = ()  # sentences that refuse a take-off now
        self.is_warm = False  # set by the shell once it has run the pipeline
        self._facts: PreflightFacts | None = None  # newest facts that are not yet reported
        self._slot_owner = vehicle.name  # vehicle whose take-off spot this one uses
        self._has_flown = False
        self._settled_doubts = 0  # doubts about its poses when a take-off was allowed last
        self._fastest_m_s = 0.0  # highest speed of the last second
        self._fastest_ns = 0  # time of that speed
        self._sequence = 0
        self._reported_ns = 0  # time of the last report
        self._judged_ns = 0  # time of the last check

    def hear(self, event: AgentInput) -> None:
        """Take an input of the agent, of any kind."""
        self.inputs.hear(event)

    def update(
        self,
        view: FlightView,
        dt_s: float,
        *,
        is_airborne: bool,
        hover_frac: float,
        conditions: Iterable[Condition] = (),
        corrections: CorrectionsStatus | None = None,
        people_m: Mapping[str, float] | None = None,
        slot_owner: str = "",
    ) -> tuple[str, ...]:
        """Take one tick on the ground; return the sentences that refuse a take-off.

        Args:
            view: what the flight knows of its vehicle.
            dt_s: time since the last tick.
            is_airborne: whether the vehicle is in the air, according to PX4 or the flight.
            hover_frac: hover throttle learned in the newest flight; NaN before the first one.
            conditions: conditions of the failsafe table that hold.
            corrections: status of the corrections; None: the vehicle uses none.
            people_m: distance to the circle of each person that the mocap sees.
            slot_owner: vehicle whose take-off spot this one uses; empty: itself.
        """
        self._observe(view, dt_s)
        now_ns = view.now_ns
        # a negative time since the last check means that a clock was set back
        if 0 <= now_ns - self._judged_ns < _JUDGE_EVERY_NS:
            return self.not_ready

        self._judged_ns = now_ns
        self._state_ages.update(self._neighbours.followed_ages_s(now_ns))
        self._slot_owner = self._vehicle.name
        if slot_owner:
            self._slot_owner = slot_owner
        if people_m is None:
            people_m = {}
        facts = self._gather(view, hover_frac, is_airborne=is_airborne)
        self._facts = replace(
            facts,
            conditions=frozenset(conditions),
            corrections=corrections,
            people_m=people_m,
        )
        self.not_ready = all_rules.reasons(self._facts, self._fleet, self._vehicle)
        if not self.not_ready:
            self._settled_doubts = self._own.validator.doubts
        return self.not_ready

    def _observe(self, view: FlightView, dt_s: float) -> None:
        """Update the values that need every tick: rate and tilt of the attitude, highest speed."""
        now_ns = view.now_ns
        self._attitude.update(now_ns, view.snapshot.attitude_ns)
        if self.inputs.sample is not None:
            self._tilt.update(self.inputs.sample.quaternion_enu_flu_wxyz, view.snapshot, dt_s)

        speed_m_s = math.hypot(*view.velocity_enu_m_s)
        if speed_m_s >= self._fastest_m_s or now_ns - self._fastest_ns > _AT_REST_NS:
            self._fastest_m_s = speed_m_s
            self._fastest_ns = now_ns
        if self._flight.state == "landed":
            self._has_flown = True

    @property
    def _may_be_anywhere(self) -> bool:
        """Whether it has landed somewhere, and its poses have shown it without a break since."""
        return self._has_flown and self._own.validator.doubts == self._settled_doubts

    def reasons_in_air(self, view: FlightView, hover_frac: float) -> tuple[str, ...]:
        """Return the sentences that refuse to take over a flying vehicle."""
        facts = self._gather(view, hover_frac, is_airborne=True)
        return all_rules.reasons(facts, self._fleet, self._vehicle, takeover.RULES)

    def due(self, now_ns: int) -> PreflightReport | None:
        """Return the report if it is due, otherwise None. It is due once a second if there are new
        facts.
        """
        facts = self._facts
        self._facts = None
        if facts is None or now_ns - self._reported_ns < _REPORT_EVERY_NS:
            return None

        self._reported_ns = now_ns
        self._sequence += 1
        position_enu_m = None
        if facts.has_position:
            position_enu_m = facts.position_enu_m
        self._refusals.judge_spot(position_enu_m)
        facts = replace(facts, law_refusals=self._refusals.current)
        checks = all_rules.checks(facts, self._fleet, self._vehicle)
        return PreflightReport(
            vehicle=self._vehicle.name,
            boot_id=self.inputs.boot_id,
            sequence=self._sequence,
            stamp_ns=now_ns,
            checks=tuple(
                (check.name, check.is_ok, check.sentence, check.remedy) for check in checks
            ),
            px4_version=facts.px4_version,
        )

    def _gather(self, view: FlightView, hover_frac: float, *, is_airborne: bool) -> PreflightFacts:
        """Return the facts of this tick."""
        now_ns = view.now_ns
        snapshot = view.snapshot
        own = self._own
        inputs = self.inputs
        neighbours = self._neighbours

        px4_nonsense = ""
        if _age_s(now_ns, inputs.dropped.last_packet_ns) < _DROPPED_LATELY_S:
            px4_nonsense = nonsense(inputs.dropped)
        px4_position_enu_m = None
        if snapshot.local_position_ns:
            px4_position_enu_m = enu_from_ned(snapshot.position_local_ned_m)
        battery_frac, battery_voltage_v = snapshot.battery(now_ns)
        is_camera_turned = snapshot.is_position_known and self._own.has_turned_camera(snapshot)

        missing = self._missing(now_ns)
        without_position = neighbours.without_position(now_ns)

        certificate_left = None
        if inputs.certificate is not None:
            certificate_left = (inputs.certificate.node, inputs.certificate.left_s)

        sample_delay_s = None
        sample_age_s = math.inf
        if inputs.sample is not None:
            sample_delay_s = inputs.sample.delay_s
            sample_age_s = _age_s(now_ns, inputs.sample.received_ns)

        stands_in_for = ""
        if self._slot_owner != self._vehicle.name:
            stands_in_for = self._slot_owner

        return PreflightFacts(
            # PX4
            autopilot_age_s=_age_s(now_ns, snapshot.last_packet_ns),
            heartbeat_age_s=_age_s(now_ns, snapshot.heartbeat_ns),
            px4_version=snapshot.px4_version,
            px4_nonsense=px4_nonsense,
            refused=snapshot.refused,
            refused_age_s=_age_s(now_ns, snapshot.refused.newest_ns),
            is_signed=snapshot.is_signed,
            has_signing_clock_behind=snapshot.has_wrong_clock,
            attitude_hz=self._attitude.rate_hz,
            has_landed_report=view.has_landed_report,
            is_armed=snapshot.is_armed and self._flight.step is not FlightStep.ARMED,
            is_failsafe=snapshot.is_failsafe,
            unhealthy=unhealthy(snapshot, self._vehicle.flies_by_satellites),
            has_rc=has_rc(snapshot),
            battery_frac=battery_frac,
            battery_voltage_v=battery_voltage_v,
            px4_position_enu_m=px4_position_enu_m,
            fuses_position=bool(self._fused & FUSES_POSITION),
            fuses_heading=bool(self._fused & FUSES_HEADING),
            param_problems=inputs.param_problems,
            fix_type=_fix_type(snapshot, now_ns),
            # own position
            position_age_s=own.age_s,
            position_enu_m=view.position_enu_m,
            speed_m_s=self._fastest_m_s,
            sample_delay_s=sample_delay_s,
            sample_age_s=sample_age_s,
            source_problem=inputs.source_problem,
            pose_sources=inputs.pose_sources(now_ns),
            spots_seen_enu_m=self._spots_seen(view),
            stands_in_for=stands_in_for,
            position_std_m=own.position_std_m,
            displaced_m=self._own.displaced_m,
            is_camera_turned=is_camera_turned,
            is_contradicted=self._own.validator.is_contradicted,
            heading_miss_rad=own.heading_offset_rad,
            tilt_miss_rad=self._tilt.difference_rad,
            differed_when_tilted=self._tilt.differed_when_tilted,
            # the flight
            is_airborne=is_airborne,
            has_flown=self._has_flown,
            may_be_anywhere=self._may_be_anywhere,
            hover_frac=hover_frac,
            # bus and other vehicles
            has_duplicate=inputs.has_duplicate(now_ns),
            missing_neighbours=tuple(name for name in missing if name not in without_position),
            lost_neighbours=tuple(name for name in missing if name in without_position),
            radio=self._state_ages.measured,
            clock_bounds_s=inputs.clock_bounds_s,
            other_hashes=neighbours.other_hashes(self._config_hash, now_ns),
            config_hash=self._config_hash,
            certificate_left=certificate_left,
            has_recorder=inputs.has_recorder,
            has_emulator=inputs.has_emulator,
            # law and loop
            law=self._fleet.law.name,
            law_refusals=self._refusals.current,
            is_law_warm=self.is_warm,
            loop_p99_ms=inputs.loop_p99_ms,
        )

    def _spots_seen(self, view: FlightView) -> dict[str, Xyz]:
        """Return the positions [m], ENU, of the vehicles that are still where people placed them.

        A vehicle that stands in for another one appears under the replaced vehicle's name. Vehicles
        out of service are left out, because they may have been carried away.
        """
        spots: dict[str, Xyz] = {}
        if self._own.age_s < POSITION_STALE_S and not self._may_be_anywhere:
            spots[self._slot_owner] = view.position_enu_m
        for name, telemetry in self._neighbours.telemetries().items():
            is_put_down = telemetry.state in _BEFORE_FLIGHT and not telemetry.is_airborne
            if not is_put_down or not telemetry.is_position_valid or telemetry.disabled_by:
                continue
            slot_owner = name
            if telemetry.stands_in_for:
                slot_owner = telemetry.stands_in_for
            if slot_owner in self._fleet.vehicles:  # a message may contain any name
                spots[slot_owner] = telemetry.position_enu_m
        return spots

    def _missing(self, now_ns: int) -> tuple[str, ...]:
        """Return required vehicles that send no valid states and are not replaced."""
        replaced = self._neighbours.replaced(self._slot_owner, now_ns)
        missing = self._neighbours.missing(now_ns)
        return tuple(name for name in missing if name not in replaced)


def _fix_type(snapshot: Snapshot, now_ns: int) -> int | None:
    """Return the type of the newest fix; None if PX4 has not reported one recently."""
    if snapshot.fix_ns == 0 or now_ns - snapshot.fix_ns > FIX_KNOWN_NS:
        return None
    return snapshot.fix_type


def _age_s(now_ns: int, then_ns: int) -> float:
    """Return the time since ``then_ns`` [s]; infinite if ``then_ns`` is 0, which means never."""
    if then_ns == 0:
        return math.inf
    return (now_ns - then_ns) * 1e-9
