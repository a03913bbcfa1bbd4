"""Go or no-go: everything that must be true before take-off, as a table with its words. Pure.

A rule looks at the facts; what it finds is fine, cannot be judged yet, or is one of its faults. A fault refuses
take-off, an advice does not. Sentences and remedies stand in the table, so that the page in docs/ is printed from it
and an order is refused in the words that the preflight page shows.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.safety import preflight_judgements as judge
from onboard.safety.preflight_judgements import OK, SKIP, Judgement, PreflightFacts


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """One answer: not ok refuses take-off, ok with a remedy is advice."""

    name: str
    is_ok: bool
    sentence: str
    remedy: str = ""


@dataclass(frozen=True, slots=True)
class RuleFault:
    """What a rule can find: sentence and remedy as templates."""

    sentence: str
    remedy: str
    is_advice: bool = False


@dataclass(frozen=True, slots=True)
class PreflightRule:
    """One line of the preflight page: what it asks, what it says when that is so, its faults, and who judges."""

    name: str
    asks: str
    passes: str
    faults: Mapping[str, RuleFault]
    judge: Callable[[PreflightFacts, FleetConfig, Vehicle], Judgement]

    def check(self, facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> PreflightCheck:
        """The answer in words."""
        key, words = self.judge(facts, fleet, vehicle)
        words = {"name": vehicle.name, "autopilot": vehicle.autopilot, "body": vehicle.body, **words}
        if key == OK:
            return PreflightCheck(self.name, True, self.passes.format(**words))
        if key == SKIP:
            return PreflightCheck(self.name, True, "Not judged {without}.".format(**words))
        fault = self.faults[key]
        return PreflightCheck(self.name, fault.is_advice, fault.sentence.format(**words), fault.remedy.format(**words))


def checks(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> tuple[PreflightCheck, ...]:
    """All answers, in the table's order."""
    return tuple(rule.check(facts, fleet, vehicle) for rule in RULES)


def reasons(
    facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle, only: Collection[str] | None = None
) -> tuple[str, ...]:
    """What refuses take-off, in words with the remedy, in the table's order; empty when nothing does.

    Args:
        only: names of the rules to ask; all by default.
    """
    return tuple(_refusals(facts, fleet, vehicle, only))


def _refusals(
    facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle, only: Collection[str] | None
) -> Iterator[str]:
    for rule in RULES:
        if only is not None and rule.name not in only:
            continue
        key, _ = rule.judge(facts, fleet, vehicle)
        if key not in (OK, SKIP) and not rule.faults[key].is_advice:
            check = rule.check(facts, fleet, vehicle)
            yield f"{check.sentence} {check.remedy}"


_FIND_OUT_HOW = "See docs/deployment.md for the cable, the port and PX4's MAV_ parameters."

RULES: tuple[PreflightRule, ...] = (
    PreflightRule(
        "px4",
        f"PX4 was heard within {judge.AUTOPILOT_SILENT_S:g} s, its heartbeat within {judge.HEARTBEAT_SILENT_S:g} s.",
        "PX4 speaks at {autopilot}; its last heartbeat is {age:.1f} s old.",
        {"silent": RuleFault("Nothing is heard from PX4 at {autopilot}.", "Start it, or check cable and port.")},
        judge.px4,
    ),
    PreflightRule(
        "link",
        f"PX4's attitude arrives at {judge.LEAST_ATTITUDE_HZ:g} Hz or more; below {judge.USUAL_ATTITUDE_HZ:g} Hz is "
        "worth a word.",
        "Attitude arrives at {rate:.0f} Hz.",
        {
            "slow": RuleFault(
                "PX4's attitude arrives at only {rate:.0f} Hz, where flight asks for 50 Hz.",
                f"Use a faster link (921600 baud, or Ethernet). {_FIND_OUT_HOW}",
            ),
            "thin": RuleFault(
                "PX4's attitude arrives at {rate:.0f} Hz of the 50 Hz that were asked for.",
                "It can fly so; look for a slow link or a busy computer.",
                is_advice=True,
            ),
        },
        judge.link,
    ),
    PreflightRule(
        "alone",
        "No other agent speaks for this vehicle.",
        "Only this agent speaks for {name}.",
        {
            "duplicate": RuleFault(
                "Another agent speaks for {name} as well.", "Stop one of the two; neither flies until then."
            )
        },
        judge.alone,
    ),
    PreflightRule(
        "health",
        "PX4 is in no failsafe and calls the sensors healthy that flight needs.",
        "PX4 calls its sensors healthy.",
        {
            "failsafe": RuleFault("PX4 is in a failsafe.", "Look at its own message, remove the cause, restart PX4."),
            "unhealthy": RuleFault(
                "PX4 calls these unhealthy: {sensors}.", "Calibrate or repair them, and restart PX4 on level ground."
            ),
            "unneeded": RuleFault(
                "PX4 calls these unhealthy: {sensors}.",
                "This flight does not need them; nothing to do.",
                is_advice=True,
            ),
        },
        judge.health,
    ),
    PreflightRule(
        "disarmed",
        "PX4 is on the ground and disarmed: nobody else has begun a flight.",
        "PX4 is disarmed.",
        {
            "airborne": RuleFault("PX4 says that it is in the air.", "Land it from the transmitter, or order land."),
            "armed": RuleFault(
                "PX4 is armed already, not by this agent.", "Disarm it: the disarm order, or the transmitter."
            ),
        },
        judge.disarmed,
    ),
    PreflightRule(
        "failsafe",
        "Nothing holds for which the failsafe table refuses take-off, beside what has a line of its own here: a mocap "
        "that repeats itself, jumps or is late, a full disk, a clock that jumped, a restarted PX4, a battery falling "
        "fast.",
        "No failsafe refuses take-off.",
        {
            "holds": RuleFault(
                "{conditions}.",
                "It goes with its cause; docs/failsafe.md says what each one means. After a pose that jumped in "
                "flight: look at the body's markers, then start this agent anew.",
            ),
        },
        judge.failsafe,
    ),
    PreflightRule(
        "parameters",
        "PX4's parameters are what this fleet needs: failsafes, mocap fusion, and the fleet file's px4_params.",
        "PX4's parameters are as this fleet needs them.",
        {
            "unread": RuleFault("PX4's parameters are not read yet.", "Wait a moment."),
            "differ": RuleFault(
                "{problems}",
                "Set them with 'covey px4 params --fleet {fleet} --vehicles {name} --apply', "
                "or start the agent with --apply-params.",
            ),
        },
        judge.parameters,
    ),
    PreflightRule(
        "position",
        f"The position is younger than {judge.POSITION_STALE_S:g} s.",
        "At {where}, {age:.0f} ms old.",
        {
            "untracked": RuleFault(
                "No fresh position from mocap body '{body}'.",
                "Check that it is tracked, published under this name (covey mocap) and heard by this computer.",
            ),
            "source": RuleFault(
                "No fresh position from mocap body '{body}': {problem}",
                "Correct [mocap] in the fleet file or the mocap itself, and see it work with 'covey mocap --check'.",
            ),
            "silent": RuleFault(
                "No fresh position from PX4's local position.",
                "Wait until PX4's estimator has a position (satellites, vision), and check its rate on this link.",
            ),
        },
        judge.position,
    ),
    PreflightRule(
        "clock",
        f"Mocap samples are at most {judge.OLDEST_SAMPLE_S:g} s old on arrival and not from the future: one clock, or "
        f"a measured offset. Other computers' clocks are measured; known worse than {1e3 * judge.WIDE_CLOCK_S:g} ms is "
        "worth a word.",
        "Stamps and this computer's clock agree.",
        {
            "mocap": RuleFault(
                "Mocap samples arrive with stamps {gap}.",
                "The sender has another clock: run 'covey mocap' on the computer that reads the mocap, so that the "
                "offset is measured, or restart the sender.",
            ),
            "unmeasured": RuleFault(
                "The clock of {others} is not measured yet.",
                "Wait a second; if it stays, that computer does not hear this one: check its connection to this agent.",
            ),
            "wide": RuleFault(
                "The clock of {other} is known to {bound:.0f} ms only, which counts as age of all that it says.",
                "Look for a slow or busy network between the two computers.",
                is_advice=True,
            ),
        },
        judge.clock,
    ),
    PreflightRule(
        "agreement",
        f"Mocap and PX4 agree: tilt within {judge.TILT_MISS_DEG:g} degrees, now and when last tilted by hand; heading "
        f"within {judge.HEADING_MISS_DEG:g} degrees and position within {judge.FAR_FROM_PX4_M:g} m, if PX4 fuses them.",
        "Mocap and PX4 agree: heading within {turn:.0f} and tilt within {tilt:.0f} degrees.",
        {
            "tilt": RuleFault(
                "Mocap and PX4 disagree by {tilt:.0f} degrees about which way is up.",
                "Align the body's axes in the mocap software with the vehicle standing level: x forward, z up, and the "
                "mocap's z axis up.",
            ),
            "handled": RuleFault(
                "When the vehicle was last tilted by hand, mocap and PX4 saw it tilt in different directions.",
                "Body '{body}' is on another vehicle, or its axes are turned: correct it, then tilt the vehicle again.",
            ),
            "heading": RuleFault(
                "Mocap and PX4 disagree by {heading:.0f} degrees about the heading, although PX4 is told the mocap's.",
                "Align the body's x axis with the vehicle's nose, check the mocap's frame, and that PX4 fuses the "
                "heading (EKF2_EV_CTRL).",
            ),
            "untold": RuleFault(
                "PX4 tells no local position.", "Wait until it has fused the mocap; check EKF2_EV_CTRL."
            ),
            "apart": RuleFault(
                "PX4 believes to be at {px4}, {away:.2f} m from where the mocap sees it.",
                "Wait a few seconds; if it stays, PX4 does not fuse the mocap: check EKF2_EV_CTRL, EKF2_HGT_REF and "
                "EKF2_GPS_CTRL, and restart PX4.",
            ),
            "compass": RuleFault(
                "The mocap's heading is {heading:.0f} degrees from PX4's compass.",
                "The agent takes the heading from the mocap; make sure that the body's x axis is the vehicle's nose.",
                is_advice=True,
            ),
        },
        judge.agreement,
    ),
    PreflightRule(
        "at rest",
        f"The vehicle stands: slower than {judge.MOVING_M_S:g} m/s.",
        "It stands still.",
        {"moving": RuleFault("It moves with {speed:.1f} m/s.", "Put it down; if it stands, look for reflections.")},
        judge.at_rest,
    ),
    PreflightRule(
        "spot",
        f"With a mocap it stands within {judge.OFF_SPOT_M:g} m of its start_enu_m, unless this agent has flown it: "
        "a turned or mirrored frame and swapped bodies are seen here.",
        "It stands {off:.2f} m from its take-off spot.",
        {
            "swapped": RuleFault(
                "The mocap sees it at {where}, on the take-off spot of {other}.",
                "Check which body is on which vehicle and the axes of the mocap, or carry it to its own spot {spot}.",
            ),
            "away": RuleFault(
                "The mocap sees it at {where}, {off:.2f} m from its take-off spot {spot}.",
                "If it stands there, correct start_enu_m or carry it to its spot; else the mocap's frame is turned or "
                "mirrored: correct its axes.",
            ),
        },
        judge.spot,
    ),
    PreflightRule(
        "fence",
        "Position and take-off spot lie inside the geofence.",
        "Inside the geofence.",
        {
            "spot": RuleFault(
                "The take-off spot {spot} lies outside the geofence.", "Correct start_enu_m or geofence_m."
            ),
            "outside": RuleFault("Position {where} lies outside the geofence.", "Carry the vehicle inside."),
        },
        judge.fence,
    ),
    PreflightRule(
        "neighbours",
        "Every vehicle with enabled = true is heard on the bus.",
        "All {count} others are heard.",
        {
            "unheard": RuleFault(
                "{who} {are} not heard on the bus.",
                "Start the {agents}, or set enabled = false in the fleet file of all.",
            )
        },
        judge.neighbours,
    ),
    PreflightRule(
        "configuration",
        "All vehicles fly with the same fleet file.",
        "All fly with configuration {hash}.",
        {
            "differs": RuleFault(
                "{who} flies with another fleet file ({other}, here {hash}).", "Restart both with the same one."
            )
        },
        judge.configuration,
    ),
    PreflightRule(
        "law",
        "The law can keep the promise with this fleet file, at the places where vehicles stand and in their slots: the "
        "findings of docs/check.md. Baselines (law paper, off) are only advised against.",
        "Law '{law}' can be flown with this fleet at these places.",
        {
            "refused": RuleFault("{finding}", "{change}"),
            "baseline": RuleFault("{finding}", "{change} This is law '{law}', flown to compare.", is_advice=True),
        },
        judge.law,
    ),
    PreflightRule(
        "hover thrust",
        f"The hover throttle learned in flight is within {100 * judge.HOVER_SHARE:g} % of the fleet file's; beyond "
        f"{100 * judge.HOVER_ADVICE_SHARE:g} % is worth a word.",
        "Hovers at {learned:.2f} of its throttle.",
        {
            "far": RuleFault(
                "It hovered at {learned:.2f} of its throttle, the fleet file says {file:.2f}.",
                "Look for a wrong propeller, load or battery; else set hover_thrust_frac (covey identify).",
            ),
            "off": RuleFault(
                "It hovered at {learned:.2f} of its throttle, the fleet file says {file:.2f}.",
                "Set hover_thrust_frac (covey identify).",
                is_advice=True,
            ),
        },
        judge.hover,
    ),
    PreflightRule(
        "battery",
        "PX4 tells a plausible battery, above battery_warning_pct of the fleet file.",
        "Battery at {level:.0f} %, {volts:.1f} V.",
        {
            "untold": RuleFault(
                "PX4 tells no battery level.", "Wait a second; if it stays, set up PX4's battery (BAT1_...)."
            ),
            "implausible": RuleFault(
                "PX4 tells a battery of {level:.0f} % and {volts:.1f} V, which cannot be.",
                "Check the power module and PX4's battery calibration (BAT1_...).",
            ),
            "low": RuleFault("Battery at {level:.0f} %, take-off needs {need:.0f} %.", "Charge or change it."),
        },
        judge.battery,
    ),
    PreflightRule(
        "loop",
        f"The control pipeline is warm; periods above {judge.LATE_LOOP_MS:g} ms are worth a word.",
        "The control loop keeps its time (99 % of periods within {p99:.1f} ms).",
        {
            "warming": RuleFault("The control pipeline is still warming up.", "Wait a moment."),
            "late": RuleFault(
                "1 % of the control loop's periods are longer than {p99:.0f} ms, where 20 ms are due.",
                "Give this computer less to do, or more cores.",
                is_advice=True,
            ),
        },
        judge.loop,
    ),
    PreflightRule(
        "record",
        "Somebody records the flight. Only advice: a record keeps nobody away from people.",
        "A recorder is on the bus.",
        {
            "none": RuleFault(
                "Nobody records this flight.",
                "Fly it with covey fly, which records, so that you can see afterwards what happened.",
                is_advice=True,
            )
        },
        judge.record,
    ),
    PreflightRule(
        "kill switch",
        "The radio control's kill switch is in somebody's hand: the one way past all computers. Always advice, as "
        "no computer can see a hand.",
        "",
        {
            "heard": RuleFault(
                "PX4 hears a radio control.", "Have its kill switch in somebody's hand, tried today.", is_advice=True
            ),
            "unheard": RuleFault(
                "PX4 hears no radio control: only the computers can stop it.",
                "Switch the transmitter on and try its kill switch; without one, keep a net between it and people.",
                is_advice=True,
            ),
            "unknown": RuleFault(
                "Whether PX4 hears a radio control is not known.",
                "Have its kill switch in somebody's hand, tried today.",
                is_advice=True,
            ),
        },
        judge.kill_switch,
    ),
)


def page() -> str:
    """The table for docs/preflight.md: every rule with its faults and remedies."""
    lines: list[str] = []
    for rule in RULES:
        lines += [f"### {rule.name}", "", rule.asks, "", "| says | what to do |", "|---|---|"]
        for fault in rule.faults.values():
            lines.append(f"| {'' if fault.is_advice else '**no-go** '}{fault.sentence} | {fault.remedy} |")
        lines.append("")
    return "\n".join(lines).strip()
