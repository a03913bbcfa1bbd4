"""Rules of preflight about PX4: link, health, arming, failsafes and parameters. Pure."""

from __future__ import annotations

from onboard.config.fleet import FleetConfig, Vehicle
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation, in_order
from onboard.safety.limits import AUTOPILOT_SILENT_S
from onboard.safety.preflight_facts import HEARTBEAT_SILENT_S, PreflightFacts
from onboard.safety.preflight_rule import FINE, NO_PX4, OK, SKIP, Judgement, PreflightRule, RuleFault

_EVERY_NETWORK = ("", "0.0.0.0", "::", "[::]")
LEAST_ATTITUDE_HZ, USUAL_ATTITUDE_HZ = 20.0, 35.0

# conditions that another rule shows; for SHUTDOWN, the refusal of the order itself does
_OF_OTHER_RULES = frozenset(
    {
        *(Condition.POSITION_STALE, Condition.POSITION_LOST, Condition.AUTOPILOT_SILENT, Condition.AUTOPILOT_FROZEN),
        *(Condition.HEARTBEAT_LOST, Condition.TWIN, Condition.SHUTDOWN, Condition.BUS_LOST, Condition.BUS_LOST_LONG),
        *(Condition.SEPARATION_BREACHED, Condition.CONFIG_DIFFERS, Condition.BATTERY_WARNING, Condition.BATTERY_LOW),
        *(Condition.FENCE_BREACH, Condition.FENCE_BREACH_LONG),
    }
)


def _px4(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_autopilot:
        return OK, {"age": facts.heartbeat_age_s}
    return ("nonsense", {"sentence": facts.px4_nonsense}) if facts.px4_nonsense else ("silent", {})


def _link(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    if facts.attitude_hz is None:
        return SKIP, {"reason": "in the first second"}
    is_slow, is_low = facts.attitude_hz < LEAST_ATTITUDE_HZ, facts.attitude_hz < USUAL_ATTITUDE_HZ
    return ("slow" if is_slow else "low" if is_low else OK), {"rate": facts.attitude_hz}


def _port(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    host = vehicle.autopilot.removeprefix("udpin://").rpartition(":")[0]
    return ("open" if vehicle.autopilot.startswith("udpin://") and host in _EVERY_NETWORK else OK), {}


def _alone(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    return ("duplicate", {}) if facts.has_duplicate else FINE


def _health(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    if facts.is_failsafe:
        return "failsafe", {}
    for is_required, key in ((True, "unhealthy"), (False, "not required")):
        names = ", ".join(name for name, required in facts.unhealthy if required is is_required)
        if names:
            return key, {"sensors": names}
    return FINE


def _disarmed(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    return ("airborne", {}) if facts.is_airborne else ("armed", {}) if facts.is_armed else FINE


def _failsafe(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    # with a wrong clock the rule "clock" has the sentence
    of_clock = {Condition.MOCAP_LATE, Condition.CLOCK_JUMPED} if facts.has_wrong_clock else set()
    names = [
        condition.value
        for condition in in_order(facts.conditions - _OF_OTHER_RULES - of_clock)
        if TABLE[Situation.GROUND, condition] is Action.REFUSE
    ]
    if not names:
        return FINE
    text = ", ".join(names)
    return "holds", {"conditions": text[0].upper() + text[1:]}


def _parameters(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    if facts.param_problems is None:
        return "unread", {}
    words = {"problems": " ".join(facts.param_problems), "fleet": fleet.path}
    return ("differ" if facts.param_problems else OK), words


AUTOPILOT_RULES = (
    PreflightRule(
        "px4",
        f"PX4 was heard within {AUTOPILOT_SILENT_S:g} s, its heartbeat within {HEARTBEAT_SILENT_S:g} s.",
        "PX4 is heard at {autopilot}; its last heartbeat is {age:.1f} s old.",
        {
            "silent": RuleFault("PX4 is not heard at {autopilot}.", "Start PX4, or check the cable and the port."),
            "nonsense": RuleFault(
                "{sentence} Nobody can fly by that.", "Check that poses reach this agent, then restart PX4."
            ),
        },
        _px4,
    ),
    PreflightRule(
        "link",
        f"PX4's attitude arrives at {LEAST_ATTITUDE_HZ:g} Hz or more; below {USUAL_ATTITUDE_HZ:g} Hz there is advice.",
        "PX4's attitude arrives at {rate:.0f} Hz.",
        {
            "slow": RuleFault(
                "PX4's attitude arrives at only {rate:.0f} Hz; flight requires 50 Hz.",
                "Use a faster link (921600 baud, or Ethernet). See docs/deployment.md for the cable, the port and "
                "PX4's MAV_ parameters.",
            ),
            "low": RuleFault(
                "PX4's attitude arrives at {rate:.0f} Hz instead of the requested 50 Hz.",
                "It can fly so; look for a slow link or a busy computer.",
                is_advice=True,
            ),
        },
        _link,
    ),
    PreflightRule(
        "port",
        "The agent's MAVLink port is open to one network only, best to none: MAVLink has no check of the source.",
        "PX4 is heard by {autopilot} only.",
        {
            "open": RuleFault(
                "{autopilot} listens on every network of this computer: whoever reaches it can play this PX4.",
                "Use a serial cable or udpin://127.0.0.1:PORT in 'autopilot'; over Ethernet the address of that one "
                "interface. See docs/who-can-fly.md.",
                is_advice=True,
            )
        },
        _port,
    ),
    PreflightRule(
        "alone",
        "No other agent runs for this vehicle.",
        "Only this agent runs for {name}.",
        {
            "duplicate": RuleFault(
                "Another agent runs for {name} as well.", "Stop one of the two agents; neither flies while both run."
            )
        },
        _alone,
    ),
    PreflightRule(
        "health",
        "PX4 is in no failsafe, and the sensors that this flight requires are healthy.",
        "PX4 reports healthy sensors.",
        {
            "failsafe": RuleFault(
                "PX4 is in a failsafe.", "Read PX4's own message, remove the cause, and restart PX4."
            ),
            "unhealthy": RuleFault(
                "PX4 reports unhealthy sensors: {sensors}.",
                "Calibrate or repair them, and restart PX4 on level ground.",
            ),
            "not required": RuleFault(
                "PX4 reports unhealthy sensors: {sensors}.",
                "This flight does not require them; nothing to do.",
                is_advice=True,
            ),
        },
        _health,
    ),
    PreflightRule(
        "disarmed",
        "PX4 is on the ground and disarmed, so that nobody else has begun a flight.",
        "PX4 is disarmed.",
        {
            "airborne": RuleFault(
                "PX4 reports that the vehicle is in the air.", "Land it with the transmitter, or order land."
            ),
            "armed": RuleFault(
                "PX4 is armed already, but not by this agent.", "Disarm it: order disarm, or use the transmitter."
            ),
        },
        _disarmed,
    ),
    PreflightRule(
        "failsafe",
        "No condition holds for which the failsafe table refuses take-off, apart from those that other rules show: a "
        "mocap that repeats itself, jumps or is late, a full disk, a clock that jumped, a restarted PX4, a battery "
        "falling fast.",
        "No failsafe refuses take-off.",
        {
            "holds": RuleFault(
                "{conditions}.",
                "Remove the cause; docs/failsafe.md explains each condition. After a pose that jumped in flight: check "
                "the body's markers, then restart this agent.",
            ),
        },
        _failsafe,
    ),
    PreflightRule(
        "parameters",
        "PX4's parameters are as this fleet requires: failsafes, mocap fusion, and the fleet file's px4_params.",
        "PX4's parameters are as this fleet requires.",
        {
            "unread": RuleFault("PX4's parameters are not read yet.", "Wait a moment."),
            "differ": RuleFault(
                "{problems}",
                "Set them with 'covey px4 params --fleet {fleet} --vehicles {name} --apply', "
                "or start the agent with --apply-params.",
            ),
        },
        _parameters,
    ),
)
