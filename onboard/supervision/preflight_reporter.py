"""Go or no-go of one vehicle on the ground: gathers the facts, keeps the answer, and tells it once a second."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import msgspec

from onboard.autopilot import Snapshot, Vec4
from onboard.bus.schema import PreflightReport, Telemetry
from onboard.config.fleet import FleetConfig, Vec3, Vehicle
from onboard.events import (
    ClocksCompared,
    EventIn,
    LoopTimed,
    NeighbourHeard,
    NodeSeen,
    ParamsRead,
    PoseArrived,
    SourceTold,
)
from onboard.feasibility.bounds import ACCURACIES
from onboard.feasibility.finding import Finding
from onboard.feasibility.fleet_checks import error_class, fleet_findings, start_finding
from onboard.flight import takeover
from onboard.flight.context import FlightContext
from onboard.flight.types import FlightView
from onboard.localization.own_state import OwnState
from onboard.neighbours.duplicate_agents import DuplicateAgents
from onboard.neighbours.table import NeighbourTable
from onboard.px4.required_params import FUSES_HEADING, FUSES_POSITION, required_params
from onboard.px4.sensor_status import has_rc, unhealthy
from onboard.safety import preflight_rules
from onboard.safety.failsafe_table import Condition
from onboard.safety.preflight_judgements import PreflightFacts

RECORDER = "recorder"  # first word of the bus node of whoever records
_REPORT_EVERY_NS = 1_000_000_000
_JUDGE_EVERY_NS = 90_000_000  # every fifth tick: to judge takes 0.1 ms
_RATE_OVER_NS = _AT_REST_NS = 1_000_000_000
_TWIN_FOR_NS = 3_000_000_000
_TILT_TIME_S = 0.5
_HANDLED_RAD, _WRONG_TILT_RAD = math.radians(12.0), math.radians(10.0)

Refusal = tuple[str, str, str]


class PreflightReporter:
    """Everything that one vehicle must be before take-off.

    not_ready: what refuses it now, in words. is_warm: whether the shell has run the pipeline once.
    """

    def __init__(
        self,
        fleet: FleetConfig,
        vehicle: Vehicle,
        *,
        boot_id: int,
        law: str,
        own: OwnState,
        neighbours: NeighbourTable,
        flight: FlightContext,
    ) -> None:
        self._fleet, self._vehicle, self._boot_id, self._law = fleet, vehicle, boot_id, law
        self._own, self._neighbours, self._flight = own, neighbours, flight
        self._config_hash = fleet.config_hash
        fused = int(required_params(vehicle).get("EKF2_EV_CTRL", 0)) if vehicle.mocap_required else 0
        self._fuses_position, self._fuses_heading = bool(fused & FUSES_POSITION), bool(fused & FUSES_HEADING)
        self._facts: PreflightFacts | None = None
        self.not_ready: tuple[str, ...] = ()
        self.is_warm = False
        self._problems: tuple[str, ...] | None = None
        self._loop_p99_ms = 0.0
        self._source_problem = ""
        self._recorders: set[str] = set()
        self._twin_ns: int | None = None
        self.duplicates = DuplicateAgents()
        self._clock_bounds_s: dict[str, float] = {}
        self._sample: tuple[Vec4, int, float] | None = None  # quaternion, arrival, delay of the newest mocap sample
        self._tilts: tuple[Vec3, Vec3] | None = None  # directions of up in the body, of mocap and PX4, low-passed
        self._has_wrong_tilt = self._has_flown = False
        self._attitude_ns = self._counted = 0
        self._fastest = (0.0, 0)  # speed of the last second, and when that was
        self._count_from_ns: int | None = None
        self._attitude_hz: float | None = None
        self._fleet_refusals: tuple[Refusal, ...] | None = None
        self._place_refusals: tuple[Refusal, ...] = ()
        self._sequence = self._reported_ns = self._judged_ns = 0

    def hear(self, event: EventIn) -> None:
        """Whatever the core hears."""
        match event:
            case PoseArrived(pose, received_ns) if pose.body == self._vehicle.body and pose.is_tracked:
                self._sample = pose.quaternion_enu_flu_wxyz, received_ns, (received_ns - pose.stamp_ns) * 1e-9
            case NeighbourHeard(message, received_ns) if message.vehicle == self._vehicle.name:
                if message.boot_id != self._boot_id:
                    self._twin_ns = received_ns
            case NeighbourHeard(Telemetry() as message, received_ns):
                self.duplicates.hear(message.vehicle, message.boot_id, received_ns)
                if self._vehicle.name in message.doubles:
                    self._twin_ns = received_ns
            case ClocksCompared(bounds_s):
                self._clock_bounds_s = {node: bound_s for node, bound_s in bounds_s.items() if not _is_ground(node)}
            case NodeSeen(node, is_alive) if node.partition("-")[0] == RECORDER:
                (self._recorders.add if is_alive else self._recorders.discard)(node)
            case ParamsRead(problems):
                self._problems = problems
            case LoopTimed():
                self._loop_p99_ms = event.p99_ms
            case SourceTold(sentence):
                self._source_problem = sentence

    def look(
        self,
        view: FlightView,
        dt_s: float,
        *,
        is_airborne: bool,
        hover_frac: float,
        conditions: Iterable[Condition] = (),
    ) -> tuple[str, ...]:
        """What refuses take-off at this tick on the ground; ``conditions`` of the failsafe table hold."""
        self._count_attitudes(view.now_ns, view.snapshot)
        speed_m_s = math.hypot(*view.velocity_enu_m_s)
        if speed_m_s >= self._fastest[0] or view.now_ns - self._fastest[1] > _AT_REST_NS:
            self._fastest = speed_m_s, view.now_ns
        self._compare_tilts(view.snapshot, dt_s)
        self._has_flown |= self._flight.state == "landed"
        if 0 <= view.now_ns - self._judged_ns < _JUDGE_EVERY_NS:
            return self.not_ready
        self._judged_ns = view.now_ns
        self._facts = replace(self._gather(view, is_airborne, hover_frac), conditions=frozenset(conditions))
        self.not_ready = preflight_rules.reasons(self._facts, self._fleet, self._vehicle)
        return self.not_ready

    def reasons_in_air(self, view: FlightView, hover_frac: float) -> tuple[str, ...]:
        """What refuses to take over a flying vehicle."""
        facts = self._gather(view, True, hover_frac)
        return preflight_rules.reasons(facts, self._fleet, self._vehicle, takeover.RULES)

    def due(self, now_ns: int) -> PreflightReport | None:
        """The report, once a second while :meth:`look` is called."""
        facts, self._facts = self._facts, None
        if facts is None or now_ns - self._reported_ns < _REPORT_EVERY_NS:
            return None
        self._reported_ns = now_ns
        self._sequence += 1
        self._place_refusals = self._judge_places(facts.position_enu_m) if facts.has_position else ()
        found = preflight_rules.checks(replace(facts, law_refusals=self._refusals), self._fleet, self._vehicle)
        return PreflightReport(
            vehicle=self._vehicle.name,
            boot_id=self._boot_id,
            sequence=self._sequence,
            stamp_ns=now_ns,
            checks=tuple((check.name, check.is_ok, check.sentence, check.remedy) for check in found),
        )

    def has_duplicate(self, now_ns: int) -> bool:
        """Whether another process has spoken for this vehicle just now."""
        return self._twin_ns is not None and now_ns - self._twin_ns < _TWIN_FOR_NS

    def _gather(self, view: FlightView, is_airborne: bool, hover_frac: float) -> PreflightFacts:
        now_ns, snapshot, own = view.now_ns, view.snapshot, self._own
        sample, north, east, down = self._sample, *snapshot.position_local_ned_m
        return PreflightFacts(
            autopilot_age_s=_age_s(now_ns, snapshot.last_packet_ns),
            heartbeat_age_s=_age_s(now_ns, snapshot.heartbeat_ns),
            attitude_hz=self._attitude_hz,
            is_armed=snapshot.is_armed,
            is_failsafe=snapshot.is_failsafe,
            is_airborne=is_airborne,
            unhealthy=unhealthy(snapshot, self._vehicle.mocap_required),
            has_rc=has_rc(snapshot),
            has_duplicate=self.has_duplicate(now_ns),
            position_age_s=own.age_s,
            position_enu_m=view.position_enu_m,
            speed_m_s=self._fastest[0],
            sample_delay_s=None if sample is None else sample[2],
            sample_age_s=math.inf if sample is None else _age_s(now_ns, sample[1]),
            source_problem=self._source_problem,
            px4_position_enu_m=(east, north, -down) if snapshot.local_position_ns else None,
            heading_miss_rad=own.heading_offset_rad,
            tilt_miss_rad=0.0 if self._tilts is None else _angle_rad(*self._tilts),
            has_wrong_tilt=self._has_wrong_tilt,
            fuses_position=self._fuses_position,
            fuses_heading=self._fuses_heading,
            has_flown=self._has_flown,
            hover_frac=hover_frac if self._has_flown else math.nan,
            battery_frac=snapshot.battery_frac,
            battery_voltage_v=snapshot.battery_voltage_v,
            missing_neighbours=self._neighbours.missing(now_ns),
            clock_bounds_s=self._clock_bounds_s,
            other_hashes=self._neighbours.other_hashes(self._config_hash),
            config_hash=self._config_hash,
            param_problems=self._problems,
            law=self._law,
            law_refusals=self._refusals,
            is_law_warm=self.is_warm,
            loop_p99_ms=self._loop_p99_ms,
            has_recorder=bool(self._recorders),
        )

    # -- the law -----------------------------------------------------------------------------------------------------

    @property
    def _refusals(self) -> tuple[Refusal, ...]:
        if self._fleet_refusals is None:
            key = (self._config_hash, self._law)
            if key not in _judged:
                _judged.clear()  # agents of one process fly one fleet
                _judged[key] = _refused(fleet_findings(self._flown()))
            self._fleet_refusals = _judged[key]
        return self._fleet_refusals + self._place_refusals

    def _judge_places(self, position_enu_m: Vec3) -> tuple[Refusal, ...]:
        """Where it stands, beside the nearest of those who stand as well."""
        fleet = self._flown()
        others = {
            name: told.position_enu_m
            for name, told in self._neighbours.telemetries().items()
            if told.is_position_valid and not told.is_airborne
        }
        if not others:
            return ()
        nearest = min(others, key=lambda name: math.dist(position_enu_m[:2], others[name][:2]))
        spots = {self._vehicle.name: position_enu_m, nearest: others[nearest]}
        return _refused((start_finding(fleet, spots, ACCURACIES[error_class(fleet)]),))

    def _flown(self) -> FleetConfig:
        """The fleet file with the law that is really flown."""
        fleet = self._fleet
        return msgspec.structs.replace(fleet, law=msgspec.structs.replace(fleet.law, name=self._law))

    # -- PX4 and the mocap -------------------------------------------------------------------------------------------

    def _count_attitudes(self, now_ns: int, snapshot: Snapshot) -> None:
        if not snapshot.attitude_ns:
            return  # nothing is known of a rate before the first one, and a vehicle in the air is not asked again
        if self._count_from_ns is None or now_ns - self._count_from_ns > 2 * _RATE_OVER_NS:
            self._count_from_ns, self._counted = now_ns, 0  # the first look, or the first after a flight
        if snapshot.attitude_ns != self._attitude_ns:
            self._attitude_ns = snapshot.attitude_ns
            self._counted += 1
        over_ns = now_ns - self._count_from_ns
        if over_ns >= _RATE_OVER_NS:
            self._attitude_hz = self._counted / (over_ns * 1e-9)
            self._count_from_ns, self._counted = now_ns, 0

    def _compare_tilts(self, snapshot: Snapshot, dt_s: float) -> None:
        """Up as the body sees it needs no common heading: it tells whether the body is on this vehicle at all."""
        if self._sample is None or not snapshot.attitude_ns:
            return
        seen = _body_up(self._sample[0]), _body_up(snapshot.quaternion_enu_flu_wxyz)
        if not all(map(math.isfinite, (*seen[0], *seen[1]))):
            return
        share = min(1.0, dt_s / _TILT_TIME_S)
        before = self._tilts or seen
        mocap, px4 = (_mixed(old, new, share) for old, new in zip(before, seen, strict=True))
        self._tilts = mocap, px4
        if max(_angle_rad(mocap, _UP), _angle_rad(px4, _UP)) > _HANDLED_RAD:
            self._has_wrong_tilt = _angle_rad(mocap, px4) > _WRONG_TILT_RAD


_UP: Vec3 = (0.0, 0.0, 1.0)
_judged: dict[tuple[str, str], tuple[Refusal, ...]] = {}


def _refused(findings: Iterable[Finding]) -> tuple[Refusal, ...]:
    return tuple((f.name, f.sentence.removesuffix(f" {f.remedy}"), f.remedy) for f in findings if f.status == "refused")


def _is_ground(node: str) -> bool:
    return node.startswith("ground")


def _age_s(now_ns: int, then_ns: int) -> float:
    return (now_ns - then_ns) * 1e-9 if then_ns else math.inf


def _body_up(quaternion_wxyz: Vec4) -> Vec3:
    """The fleet's up in the body's axes: the last row of the rotation."""
    w, x, y, z = quaternion_wxyz
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


def _mixed(old: Vec3, new: Vec3, share: float) -> Vec3:
    x, y, z = (a + share * (b - a) for a, b in zip(old, new, strict=True))
    return x, y, z


def _angle_rad(one: Vec3, other: Vec3) -> float:
    size = math.hypot(*one) * math.hypot(*other)
    return math.acos(max(-1.0, min(1.0, sum(a * b for a, b in zip(one, other, strict=True)) / size))) if size else 0.0
