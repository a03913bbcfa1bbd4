"""What a tick's facts say of a vehicle: its motion, its PX4, its battery, and the others."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest
from msgspec.structs import replace

from onboard.autopilot import Landed, Snapshot
from onboard.bus.schema import Order
from onboard.config.fleet import CorrectionsConfig, FleetConfig, fleet_from_mapping
from onboard.corrections.status import BaseFault, BaseJudgement, CorrectionsStatus
from onboard.flight import contact
from onboard.flight.context import FlightContext
from onboard.flight.expected_ground import ground_of_takeoff
from onboard.flight.types import FlightStep, FlightView
from onboard.localization.motion_fit import MotionFit
from onboard.localization.own_state import OwnEstimate, OwnState
from onboard.neighbours.table import NeighbourTable
from onboard.supervision.tick_context import TickContext
from onboard.supervision.tick_facts import CorrectionsFacts, ModeLoss, SlowFacts, TickFacts
from onboard.supervision.tick_observer import TickObserver
from onboard.tuples import Wxyz, Xyz
from onboard.types import Goal, LawStatus
from onboard.vectors import Vec3
from tests.onboard.agent.rig import fleet
from tests.onboard.state_messages import state_message

S = 1_000_000_000
MS = 1_000_000
TICK_NS = 20 * MS
BEGIN_NS = 100 * S
STILL = (0.0, 0.0, 0.0)
ON_ITS_SIDE: Wxyz = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)
FLEET = fleet(("mav0", "mav1", "mav2"))
NAN = math.nan


def leaning(degrees: float) -> Wxyz:
    half_rad = 0.5 * math.radians(degrees)
    return (math.cos(half_rad), math.sin(half_rad), 0.0, 0.0)


def without_mocap(config: FleetConfig) -> FleetConfig:
    vehicles = {
        name: replace(vehicle, mocap_required=False) for name, vehicle in config.vehicles.items()
    }
    return replace(config, vehicles=vehicles)


@dataclass
class Own:
    """The part of the own state that the observer reads."""

    jumped_to_enu_m: Xyz | None = None
    corrections: CorrectionsConfig | None = None
    has_lost_satellites: bool = False
    uses_heights: bool = False
    fit: MotionFit = field(default_factory=MotionFit)
    validator: Any = field(default_factory=lambda: SimpleNamespace(clock_jump_ns=0))
    wind_enu_m_s: tuple[float, float] = (0.0, 0.0)
    gust_m_s2: float = 0.0


class Observed:
    """mav0, which hovers 1 m above its ground with a PX4 that reports at each tick."""

    def __init__(
        self, step: FlightStep = FlightStep.HOLDING, config: FleetConfig = FLEET, **own: Any
    ) -> None:
        vehicle = config.vehicles["mav0"]
        self.own = Own(**own)
        self.table = NeighbourTable(config, "mav0")
        self.flight = FlightContext(config, vehicle, step=step)
        self.observer = TickObserver(
            fleet=config,
            vehicle=vehicle,
            own=cast(OwnState, self.own),
            flight=self.flight,
            neighbours=self.table,
        )
        self.now_ns = BEGIN_NS
        self.view: dict[str, Any] = {
            "position_enu_m": (0.0, 0.0, 1.0),
            "velocity_enu_m_s": STILL,
            "has_position": True,
            "position_age_s": 0.0,
        }
        self.snapshot: dict[str, Any] = {"is_armed": True, "mode": "OFFBOARD", "battery_frac": 0.9}
        self.context: dict[str, Any] = {"is_airborne": True}
        self.jumps = 0
        self.sends_heartbeats = True
        self.heartbeat_ns = BEGIN_NS

    def flies(self, **facts: Any) -> None:
        """Give the flight other facts, as its own room does."""
        for name, value in facts.items():
            setattr(self.flight, name, value)

    def tick(self) -> TickFacts:
        """Return the facts of the next tick."""
        now_ns = self.now_ns = self.now_ns + TICK_NS
        if self.sends_heartbeats:
            self.heartbeat_ns = now_ns
        reported: dict[str, Any] = {
            "last_packet_ns": now_ns,
            "attitude_ns": now_ns,
            "px4_boot_ms": now_ns // MS,
            "heartbeat_ns": self.heartbeat_ns,
            "landed": Landed.IN_AIR,
            "landed_ns": now_ns,
            "battery_ns": now_ns,
            "position_accuracy_ns": now_ns,
        }
        snapshot = Snapshot(**{**reported, **self.snapshot})
        view = FlightView(**{"now_ns": now_ns, "snapshot": snapshot, **self.view})
        signs = contact.observe(
            self.flight.contact, view, FLEET.vehicles["mav0"], sinks_without_poses=False
        )
        self.flies(contact=signs)
        own = OwnEstimate(
            state=None,
            attitude_wxyz=(1.0, 0.0, 0.0, 0.0),
            age_s=0.0,
            is_dead_reckoned=False,
            jumps=self.jumps,
            is_mocap_frozen=False,
            is_mocap_late=False,
            gust_m_s2=0.0,
            expected_gust_m_s2=0.0,
        )
        return self.observer.update(view, TickContext(**{"own": own, **self.context}))

    def run(self, seconds: float) -> TickFacts:
        """Return the facts of the last tick of this time."""
        for _ in range(round(seconds * S / TICK_NS)):
            facts = self.tick()
        return facts

    def hear(self, position_enu_m: Xyz, vehicle: str = "mav1", **changes: Any) -> None:
        """Hear a state of another vehicle, sent now."""
        message = state_message(
            vehicle=vehicle, stamp_ns=self.now_ns, position_enu_m=position_enu_m, **changes
        )
        assert self.table.hear(message, self.now_ns)


def test_a_vehicle_that_hovers_well_has_no_complaint() -> None:
    facts = Observed().run(0.1)
    fine = TickFacts(now_ns=facts.now_ns, limits=FLEET.fleet)
    differing = {
        name for name in TickFacts.__struct_fields__ if getattr(facts, name) != getattr(fine, name)
    }
    # what it is, and no fault: where it is, what it does, and that nothing is known of the ground
    assert differing == {
        *("slow", "is_slow_tick", "is_flying", "is_under_law", "is_airborne"),
        *("height_above_lowest_ground_m", "height_m", "px4_mode", "has_ground"),
    }
    assert facts.slow == SlowFacts(battery_frac=0.9, wind=facts.slow.wind)
    assert facts.slow.wind.scatter_m == 0.0


def test_the_slow_facts_come_at_each_fifth_tick_and_stay_between() -> None:
    observed = Observed()
    observed.snapshot["battery_frac"] = 0.7
    seen = []
    for _ in range(12):
        facts = observed.tick()
        seen.append((facts.is_slow_tick, facts.slow.battery_frac))
    assert seen == ([(False, 1.0)] * 4 + [(True, 0.7)] + [(False, 0.7)] * 4) + [
        (True, 0.7),
        (False, 0.7),
        (False, 0.7),
    ]


# -- own motion


def test_a_position_is_stale_from_two_tenths_of_a_second_on_and_for_as_long_as_it_is() -> None:
    observed = Observed()
    observed.view["position_age_s"] = 0.2
    assert observed.run(1.0).position_stale_s == 0.0
    observed.view["position_age_s"] = 0.21
    assert observed.tick().position_stale_s == 0.0
    assert observed.run(0.5).position_stale_s == pytest.approx(0.5)

    observed.view["position_age_s"] = 0.0
    assert observed.tick().position_stale_s == 0.0
    observed.view["position_age_s"] = 0.21
    observed.tick()
    assert observed.run(0.1).position_stale_s == pytest.approx(0.1)


def test_times_without_poses_add_up_where_poses_come_and_go() -> None:
    observed = Observed()
    for age_s in (0.3, 0.0, 0.3, 0.0, 0.3):
        observed.view["position_age_s"] = age_s
        facts = observed.run(0.5)
    # 0.5 s three times, less a fifth of the two spells between them
    assert facts.position_flicker_s == pytest.approx(1.3, abs=0.05)
    observed.view["position_age_s"] = 0.0
    assert observed.run(7.0).position_flicker_s == 0.0


def test_heights_are_those_above_the_fleets_ground_and_above_the_own() -> None:
    observed = Observed()
    observed.flies(expected_ground=ground_of_takeoff(0.3, 0.0))
    facts = observed.tick()
    assert facts.height_above_lowest_ground_m == 1.0
    assert facts.height_m == pytest.approx(0.7)

    low = replace(FLEET.vehicles["mav2"], start_enu_m=(3.0, 0.0, -0.8))
    fence = replace(FLEET.fleet.geofence_m, z=(-1.0, 3.0))
    vehicles = {**FLEET.vehicles, "mav2": low}
    config = replace(FLEET, vehicles=vehicles, fleet=replace(FLEET.fleet, geofence_m=fence))
    assert Observed(config=config).tick().height_above_lowest_ground_m == pytest.approx(1.8)


def test_a_low_vehicle_rises_only_while_it_reaches_greater_heights() -> None:
    observed = Observed()
    rises = []
    for height_m in (0.05, 0.06, 0.075, 0.06, 0.07, 0.09, 0.5, 0.11):
        observed.view["position_enu_m"] = (0.0, 0.0, height_m)
        rises.append(observed.tick().has_risen)
    assert rises == [True, False, True, False, False, False, False, True]


@pytest.mark.parametrize(
    ("jumps", "jumped_to_enu_m", "onto"),
    [
        (1, (2.0, 0.0, 1.0), ""),
        (2, (2.0, 0.0, 1.0), "mav1"),
        (2, (2.29, 0.0, 1.0), "mav1"),
        (2, (2.31, 0.0, 1.0), ""),
        (2, None, ""),
    ],
)
def test_two_jumps_within_thirty_centimetres_of_another_vehicle_are_onto_it(
    jumps: int, jumped_to_enu_m: Xyz | None, onto: str
) -> None:
    observed = Observed(jumped_to_enu_m=jumped_to_enu_m)
    observed.hear((2.0, 0.0, 1.0))
    observed.jumps = jumps
    facts = observed.tick()
    assert (facts.jumps, facts.jumped_onto) == (jumps, onto)


# -- attitude


def upset(
    step: FlightStep,
    height_m: float,
    *,
    config: FleetConfig = FLEET,
    is_dead_reckoned: bool = False,
) -> bool:
    """Return whether a vehicle on its side at a height has lost its attitude."""
    observed = Observed(step, config)
    observed.view |= {"attitude_wxyz": ON_ITS_SIDE, "is_dead_reckoned": is_dead_reckoned}
    observed.view["position_enu_m"] = (0.0, 0.0, height_m)
    return observed.run(0.5).is_attitude_lost


@pytest.mark.parametrize(
    ("step", "height_m", "is_lost"),
    [
        (FlightStep.LEG, 0.21, True),
        (FlightStep.LEG, 0.19, False),  # the ground may hold it
        (FlightStep.DESCENT, 0.21, True),
        (FlightStep.LIFTOFF, 1.0, False),
        (FlightStep.PX4_LANDING, 1.0, False),  # PX4 flies it
    ],
)
def test_the_attitude_is_watched_under_the_law_and_off_the_ground(
    step: FlightStep, height_m: float, is_lost: bool
) -> None:
    assert upset(step, height_m) is is_lost


@pytest.mark.parametrize(("height_m", "is_lost"), [(0.51, True), (0.49, False)])
def test_without_poses_the_ground_may_be_half_a_metre_higher(
    height_m: float, is_lost: bool
) -> None:
    assert upset(FlightStep.COASTING, height_m, is_dead_reckoned=True) is is_lost


@pytest.mark.parametrize(
    ("step", "height_m", "is_lost"),
    [
        (FlightStep.DESCENT, 1.01, True),
        (FlightStep.DESCENT, 0.99, False),
        (FlightStep.LEG, 0.21, True),
    ],
)
def test_in_a_landing_by_satellites_the_ground_may_be_a_metre_higher(
    step: FlightStep, height_m: float, is_lost: bool
) -> None:
    assert upset(step, height_m, config=without_mocap(FLEET)) is is_lost


def test_an_attitude_that_was_lost_is_forgotten_on_the_ground() -> None:
    observed = Observed()
    observed.view["attitude_wxyz"] = ON_ITS_SIDE
    assert observed.run(0.5).is_attitude_lost
    observed.flies(step=FlightStep.LANDED)
    assert not observed.tick().is_attitude_lost


def test_of_a_tick_of_seconds_a_tenth_of_a_second_is_believed() -> None:
    observed = Observed()
    observed.run(0.5)
    observed.view["attitude_wxyz"] = ON_ITS_SIDE
    observed.context["period_s"] = 3.0
    assert not observed.tick().is_attitude_lost
    assert observed.tick().is_attitude_lost


def test_full_thrust_below_the_trajectory_without_climbing_is_sinking() -> None:
    observed = Observed()
    observed.context |= {"thrust_frac": 1.0, "below_m": 0.5}
    observed.view["velocity_enu_m_s"] = (0.3, 0.3, 0.0)
    facts = observed.run(1.2)
    assert (facts.is_thrust_saturated, facts.is_sinking) == (True, True)

    observed = Observed()
    observed.context |= {"thrust_frac": 1.0, "below_m": 0.5}
    observed.view["velocity_enu_m_s"] = (0.0, 0.0, 0.3)
    facts = observed.run(1.2)
    assert (facts.is_thrust_saturated, facts.is_sinking) == (True, False)


# -- an attitude that is lost waits for a heartbeat, for a pilot may tilt the vehicle


def _without_heartbeats(attitude_wxyz: Wxyz) -> Observed:
    """A flight in which heartbeats stop and the attitude changes, after a second."""
    observed = Observed()
    observed.run(1.0)
    observed.sends_heartbeats = False
    observed.view["attitude_wxyz"] = attitude_wxyz
    return observed


def test_a_lost_attitude_counts_when_a_heartbeat_since_then_says_that_no_pilot_flies() -> None:
    observed = _without_heartbeats(leaning(30.0))
    assert not observed.run(0.8).is_attitude_lost
    assert observed.observer.reports.is_heartbeat_wanted

    observed.sends_heartbeats = True
    assert observed.tick().is_attitude_lost
    assert not observed.observer.reports.is_heartbeat_wanted


def test_an_attitude_is_not_lost_if_the_heartbeat_says_that_px4_flies_no_setpoints() -> None:
    observed = _without_heartbeats(leaning(30.0))
    assert not observed.run(0.8).is_attitude_lost

    observed.sends_heartbeats = True
    observed.snapshot["mode"] = "POSCTL"
    facts = observed.tick()
    assert facts.mode_loss is not ModeLoss.NONE
    assert not facts.is_attitude_lost
    assert not observed.observer.reports.is_heartbeat_wanted


def test_a_lost_attitude_counts_without_a_heartbeat_when_none_comes_any_more() -> None:
    observed = _without_heartbeats(leaning(30.0))
    assert not observed.run(1.30).is_attitude_lost
    assert observed.tick().is_attitude_lost


def test_a_heartbeat_from_before_the_attitude_was_lost_says_nothing() -> None:
    observed = Observed()
    observed.run(1.0)
    observed.view["attitude_wxyz"] = leaning(30.0)
    observed.tick()  # the low-passed difference is small yet
    observed.sends_heartbeats = False
    assert not observed.run(0.8).is_attitude_lost


def test_an_upset_vehicle_awaits_no_heartbeat() -> None:
    observed = _without_heartbeats(ON_ITS_SIDE)
    assert observed.run(0.14).is_attitude_lost
    assert not observed.observer.reports.is_heartbeat_wanted


def test_a_vehicle_that_follows_again_wants_no_heartbeat() -> None:
    observed = _without_heartbeats(leaning(30.0))
    observed.run(0.8)
    observed.view["attitude_wxyz"] = leaning(0.0)
    observed.run(0.5)
    assert not observed.observer.reports.is_heartbeat_wanted


# -- wind


@pytest.mark.parametrize(
    ("step", "is_hover"),
    [
        (FlightStep.HOLDING, True),
        (FlightStep.ARRIVED, True),
        (FlightStep.LEG, False),
        (FlightStep.DESCENT, False),
    ],
)
def test_scatter_is_measured_while_the_vehicle_hovers(step: FlightStep, is_hover: bool) -> None:
    observed = Observed()
    observed.context["setpoint_miss_m"] = 0.3
    observed.run(5.0)
    observed.flies(step=step)
    scatter_m = observed.run(0.1).slow.wind.scatter_m
    assert (scatter_m > 0.25) is is_hover


def test_a_late_tick_counts_as_a_tenth_of_a_second_of_scatter() -> None:
    observed = Observed()
    observed.run(0.08)
    observed.context |= {"setpoint_miss_m": 1.0, "period_s": 9.0}
    # one tenth of two seconds
    assert observed.tick().slow.wind.scatter_m == pytest.approx(math.sqrt(0.05))


# -- PX4


def test_the_ground_counts_by_a_recent_report() -> None:
    observed = Observed()
    observed.snapshot["landed"] = Landed.ON_GROUND
    facts = observed.tick()
    assert (facts.has_landed_report, facts.is_on_ground) == (True, True)

    observed.snapshot["landed_ns"] = observed.now_ns - 5 * S
    facts = observed.tick()
    assert (facts.has_landed_report, facts.is_on_ground) == (False, False)

    observed.snapshot |= {"landed": Landed.IN_AIR, "landed_ns": observed.now_ns}
    facts = observed.tick()
    assert (facts.has_landed_report, facts.is_on_ground) == (True, False)


def test_a_mode_that_px4_has_left_is_told_with_its_name() -> None:
    observed = Observed()
    observed.run(0.1)
    observed.snapshot["mode"] = "HOLD"
    facts = observed.tick()
    assert (facts.mode_loss, facts.px4_mode) == (ModeLoss.LEFT, "HOLD")


def test_a_px4_without_packets_is_silent() -> None:
    observed = Observed()
    observed.run(0.5)
    observed.snapshot["last_packet_ns"] = observed.now_ns
    assert not observed.run(0.3).is_px4_silent
    assert observed.tick().is_px4_silent


# -- the order


def test_an_order_that_is_late_says_how_far_and_who_kept_it_off() -> None:
    observed = Observed(FlightStep.LEG)
    order = Order(order_id="1", author="ada", kind="move", stamp_ns=BEGIN_NS, deadline_ns=0)
    goal = Goal(Vec3(0.0, 2.0, 1.0), 0.0, 1)
    observed.flies(order=order, goal=goal, deadline_ns=BEGIN_NS + S)
    observed.context["active_neighbour"] = observed.table.indices["mav2"]
    assert not observed.run(1.0).is_overdue
    late = observed.tick()
    assert late.is_overdue
    assert late.overdue_reason == "still 2.00 m to go, kept off by mav2"


def test_neighbours_that_are_avoided_while_it_hovers_keep_it_off_nothing() -> None:
    observed = Observed(FlightStep.HOLDING)
    observed.context["active_neighbour"] = observed.table.indices["mav2"]
    observed.run(2.0)
    observed.context["active_neighbour"] = -1
    observed.flies(step=FlightStep.LEG, goal=Goal(Vec3(0.0, 2.0, 1.0), 0.0, 1))
    assert observed.tick().overdue_reason == "still 2.00 m to go"


def test_a_landing_that_rises_says_so_and_nothing_of_a_way() -> None:
    observed = Observed(FlightStep.DESCENT)
    observed.flies(lowest_z_m=0.2, deadline_ns=BEGIN_NS + 9 * S)
    assert observed.tick().overdue_reason == "it has risen by 0.80 m"


# -- the fence


@pytest.mark.parametrize(
    ("position_enu_m", "has_position", "is_outside", "is_above"),
    [
        ((0.0, 0.0, 1.0), True, False, False),
        ((4.5, 0.0, 1.0), True, True, False),
        ((0.0, 0.0, 3.5), True, False, True),
        ((4.5, 0.0, 3.5), False, False, False),
    ],
)
def test_the_fence_counts_at_a_known_position(
    position_enu_m: Xyz, has_position: bool, is_outside: bool, is_above: bool
) -> None:
    observed = Observed()
    observed.view |= {"position_enu_m": position_enu_m, "has_position": has_position}
    facts = observed.tick()
    assert (facts.is_outside, facts.is_above_ceiling) == (is_outside, is_above)


@pytest.mark.parametrize(("east_m", "is_outside"), [(2.0, False), (3.2, True)])
def test_the_areas_of_a_fleet_are_its_fence(east_m: float, is_outside: bool) -> None:
    data = {
        "schema": 1,
        "fleet": {
            "name": "field",
            "geofence_m": {"x": [-4.0, 4.0], "y": [-4.0, 4.0], "z": [0.0, 3.0]},
        },
        "vehicles": {
            "mav0": {
                "system_id": 1,
                "start_enu_m": [0.0, 0.0, 0.0],
                "agent": "tcp/127.0.0.1:7460",
                "autopilot": "udpin://127.0.0.1:14540",
            }
        },
        "fences": [{"name": "a", "keep": "in", "circle": {"center_enu_m": [0, 0], "radius_m": 3}}],
    }
    observed = Observed(config=fleet_from_mapping(data))
    observed.view["position_enu_m"] = (east_m, 0.0, 1.0)
    assert observed.tick().is_outside is is_outside


# -- the others


@pytest.mark.parametrize(
    ("nearest_m", "is_airborne", "touched"),
    [(0.4, True, "mav1"), (0.6, True, ""), (0.4, False, "")],
)
def test_who_is_nearer_than_a_body_in_the_air_is_touched(
    nearest_m: float, is_airborne: bool, touched: str
) -> None:
    observed = Observed()
    observed.hear((0.4, 0.0, 1.0))
    observed.context |= {"nearest_m": nearest_m, "is_airborne": is_airborne}
    facts = observed.tick()
    assert (facts.nearest_m, facts.touched) == (nearest_m, touched)


def test_a_body_that_is_wider_than_the_safety_distance_touches_only_in_a_breach_of_it() -> None:
    wide = replace(FLEET, fleet=replace(FLEET.fleet, body_diameter_m=1.0, safety_distance_m=0.8))
    for nearest_m, touched in ((0.79, "mav1"), (0.81, "")):
        observed = Observed(config=wide)
        observed.hear((0.8, 0.0, 1.0))
        observed.context["nearest_m"] = nearest_m
        assert observed.tick().touched == touched


def test_silent_neighbours_and_those_heard_again_are_named() -> None:
    observed = Observed()
    observed.hear((2.0, 0.0, 1.0))
    assert observed.run(0.28).unseen == ("mav1",)
    assert observed.tick().silent == ("mav1",)
    observed.hear((2.0, 0.0, 1.0))
    assert observed.tick().heard_again == ("mav1",)


def test_each_problem_of_a_neighbour_is_a_slow_fact_of_its_name() -> None:
    observed = Observed()
    observed.hear((2.0, 0.0, 1.0))
    observed.hear((3.0, 0.0, 1.0), vehicle="mav2")
    observed.run(0.18)
    observed.hear((2.0, 0.0, 1.0), is_valid=False)
    facts = observed.tick()
    assert facts.is_slow_tick
    assert facts.slow.without_position == ("mav1",)
    assert facts.slow.late == ("mav1", "mav2")


# -- own process


def test_a_law_that_was_refused_is_named() -> None:
    observed = Observed()
    assert observed.tick().law_refusal == ""
    observed.context["law_refusal"] = "is slow"
    assert observed.tick().law_refusal == f"{FLEET.law.name} is slow"


@pytest.mark.parametrize("status", list(LawStatus))
def test_a_law_without_a_solution_is_infeasible(status: LawStatus) -> None:
    observed = Observed()
    observed.context["law_status"] = int(status)
    assert observed.tick().is_law_infeasible is (status is LawStatus.INFEASIBLE)


@pytest.mark.parametrize(("of_mocap_ns", "own_ns"), [(7, 3), (3, 7)])
def test_the_last_jump_of_either_clock_counts(of_mocap_ns: int, own_ns: int) -> None:
    observed = Observed(validator=SimpleNamespace(clock_jump_ns=of_mocap_ns))
    observed.context["clock_jump_ns"] = own_ns
    assert observed.run(0.1).slow.clock_jump_ns == 7


# -- energy


@pytest.mark.parametrize(
    ("step", "is_falling"),
    [
        (FlightStep.HOLDING, True),
        (FlightStep.DESCENT, True),
        (FlightStep.ARMED, False),
        (FlightStep.LANDED, False),
    ],
)
def test_a_battery_falls_in_flight_only(step: FlightStep, is_falling: bool) -> None:
    observed = Observed(step)
    for tick in range(300):
        observed.snapshot["battery_frac"] = 0.9 - 0.002 * tick
        facts = observed.tick()
    assert facts.slow.is_battery_falling is is_falling


def test_a_battery_that_fell_in_one_flight_is_judged_anew_for_the_next() -> None:
    observed = Observed()
    for tick in range(300):
        observed.snapshot["battery_frac"] = 0.9 - 0.002 * tick
        observed.tick()
    observed.flies(step=FlightStep.LANDED)
    assert not observed.run(0.1).slow.is_battery_falling
    observed.flies(step=FlightStep.HOLDING)
    assert not observed.run(2.0).slow.is_battery_falling


def falls(end_frac: float, *, height_m: float = 1.0, floor_frac: float = 0.0) -> bool:
    """Return whether a battery that loses 0.4 % a second for ten seconds is falling at its end."""
    observed = Observed()
    observed.view["position_enu_m"] = (0.0, 0.0, height_m)
    observed.context["battery_floor_frac"] = floor_frac
    for tick in range(500):
        observed.snapshot["battery_frac"] = end_frac + 0.004 * 0.02 * (500 - tick)
        facts = observed.tick()
    return facts.slow.is_battery_falling


def test_a_battery_falls_by_the_landing_level_and_by_the_height_of_the_landing() -> None:
    """Half of the landing level has to be left after a reserve of 15 s and the descent."""
    least_frac = 0.5 * 0.01 * FLEET.fleet.battery_land_pct + 0.004 * 15.0
    assert falls(least_frac)
    assert not falls(least_frac + 0.03)
    assert falls(least_frac + 0.03, height_m=20.0)
    assert not falls(least_frac + 0.03, height_m=20.0, floor_frac=least_frac)


# -- satellites


CORRECTED = msgspec.convert(
    {"source": "mock", "fix": "rtk_fixed", "max_age_s": 10.0, "hold_accuracy_m": 0.5},
    CorrectionsConfig,
)
PLAIN, FIXED = 3, 6  # MAVLink's GPS_FIX_TYPE


def corrected(status: CorrectionsStatus | None, **snapshot: Any) -> CorrectionsFacts:
    """Return the facts of a vehicle with corrections in a fixed solution, but for changes."""
    observed = Observed(config=without_mocap(FLEET), corrections=CORRECTED)
    observed.snapshot |= {"has_fix": True, "fix_ns": BEGIN_NS, "fix_type": FIXED, **snapshot}
    observed.context["corrections"] = status
    return observed.run(0.1).slow.corrections


def test_a_vehicle_in_a_fixed_solution_with_fresh_corrections_has_no_complaint() -> None:
    assert corrected(CorrectionsStatus(age_s=10.0)) == CorrectionsFacts()


def test_a_fix_below_the_demanded_one_is_told_in_words() -> None:
    assert corrected(CorrectionsStatus(), fix_type=PLAIN).fix_below == "3D"


@pytest.mark.parametrize(("age_s", "old_s"), [(10.1, 10.1), (10.0, 0.0), (math.inf, 0.0)])
def test_corrections_are_old_once_there_were_any(age_s: float, old_s: float) -> None:
    assert corrected(CorrectionsStatus(age_s=age_s)).old_s == old_s


@pytest.mark.parametrize("name", ["position_accuracy_m", "fix_accuracy_m"])
@pytest.mark.parametrize(("accuracy_m", "is_coarse"), [(0.5, False), (0.51, True)])
def test_the_worse_of_both_accuracies_decides_whether_the_position_is_coarse(
    name: str, accuracy_m: float, is_coarse: bool
) -> None:
    facts = corrected(CorrectionsStatus(), **{name: accuracy_m})
    assert facts.is_position_coarse is is_coarse


def test_a_base_that_has_moved_is_told_in_words() -> None:
    moved = CorrectionsStatus(base=BaseJudgement(BaseFault.MOVED, by_m=2.0))
    assert corrected(moved).base_fault == "has moved in flight, by 2.0 m"


def test_without_corrections_nothing_is_said_of_satellites() -> None:
    for status, corrections in ((None, CORRECTED), (CorrectionsStatus(age_s=99.0), None)):
        observed = Observed(config=without_mocap(FLEET), corrections=corrections)
        observed.context["corrections"] = status
        assert observed.run(0.1).slow.corrections == CorrectionsFacts()


def test_the_voltage_that_falls_when_a_vehicle_takes_off_is_no_falling_battery() -> None:
    observed = Observed(FlightStep.LIFTOFF)
    observed.snapshot["battery_voltage_v"] = 16.8
    observed.run(1.0)
    observed.flies(step=FlightStep.CLIMB, step_ns=observed.now_ns)
    observed.run(0.5)
    observed.snapshot["battery_voltage_v"] = 14.2  # 15 % less, under the load of flight
    assert not observed.run(4.0).slow.is_battery_falling

    observed.snapshot["battery_voltage_v"] = 12.4
    assert observed.run(2.0).slow.is_battery_falling


def test_a_vehicle_that_pushes_upwards_and_does_not_move_is_stuck() -> None:
    observed = Observed(config=without_mocap(FLEET))
    observed.flies(goal=Goal(Vec3(0.0, 0.0, 2.0), 0.0, 1))
    observed.view["thrust_share"] = 1.6
    assert not observed.run(2.9).is_stuck
    assert observed.run(0.3).is_stuck

    observed.view["thrust_share"] = 1.0
    assert not observed.run(0.1).is_stuck


@pytest.mark.parametrize(("thrust_share", "goal_z_m"), [(1.1, 2.0), (1.6, 1.4)])
def test_a_vehicle_that_hovers_below_its_goal_or_at_it_is_not_stuck(
    thrust_share: float, goal_z_m: float
) -> None:
    observed = Observed(config=without_mocap(FLEET))
    observed.flies(goal=Goal(Vec3(0.0, 0.0, goal_z_m), 0.0, 1))
    observed.view["thrust_share"] = thrust_share
    assert not observed.run(5.0).is_stuck
