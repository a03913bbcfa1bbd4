"""Rules of preflight about PX4: link, health, arming, failsafes and parameters. Pure.

Each rule returns a key and values for a sentence. The key names a sentence in ``preflight.toml``.
It is under ``[RULE.refuses]`` if the fault refuses a take-off, and under ``[RULE.advises]`` if it
is advice.
"""

from __future__ import annotations

from onboard.autopilot import MEASURED_VERSIONS, SIGNING_SINCE, Version, plausible_version
from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config.endpoints import host_of, is_on_network
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.plain_text import capitalised
from onboard.preflight.attitude_lag import lag_s
from onboard.preflight.preflight_facts import HEARTBEAT_SILENT_S, PreflightFacts
from onboard.preflight.preflight_rule import NO_PX4, OK, PASSED, SKIP, Judgement, rules
from onboard.px4.required_params import weakened
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation, in_order
from onboard.safety.limits import AUTOPILOT_SILENT_S

MIN_ATTITUDE_HZ = 20.0  # a lower rate of PX4's attitude refuses a take-off
USUAL_ATTITUDE_HZ = 35.0  # a lower rate is reported as advice

# reasons for refusing a packet that occur only if the vehicle signs
_OF_SIGNING = ("unsigned", "forged", "old")
_REASONS = {
    "malformed": "no MAVLink",
    "other_address": "under PX4's ids, from another address",
    "unsigned": "not signed",
    "forged": "signed with another key",
    "old": "signed, but older than others: a replay",
}
_EVERY_NETWORK = ("", "0.0.0.0", "::", "[::]")

# Conditions that another rule reports. SHUTDOWN is reported by the refusal of the order itself.
_OF_OTHER_RULES = frozenset(
    {
        Condition.POSITION_STALE,
        Condition.POSITION_LOST,
        Condition.POSITION_LOST_LONG,
        Condition.FIX_COARSE,
        Condition.FIX_FELL_BACK,
        Condition.BASE_FAULT,
        Condition.AUTOPILOT_SILENT,
        Condition.AUTOPILOT_FROZEN,
        Condition.HEARTBEAT_LOST,
        Condition.LANDED_UNKNOWN,
        Condition.TWIN,
        Condition.SHUTDOWN,
        Condition.BUS_LOST,
        Condition.BUS_LOST_LONG,
        Condition.SEPARATION_BREACHED,
        Condition.CONFIG_DIFFERS,
        Condition.BATTERY_WARNING,
        Condition.BATTERY_LOW,
        Condition.BATTERY_UNKNOWN,
        Condition.FENCE_BREACH,
        Condition.FENCE_BREACH_LONG,
    }
)
# conditions caused by a wrong clock; the rule "clock" reports them
_OF_A_WRONG_CLOCK = frozenset({Condition.MOCAP_LATE, Condition.CLOCK_JUMPED})


def _px4(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_autopilot:
        return OK, {"age": facts.heartbeat_age_s}
    if facts.newest_refused in _OF_SIGNING:
        return facts.newest_refused, {"name": vehicle.name, "fleet": fleet.path}
    if facts.px4_nonsense:
        return "nonsense", {"sentence": facts.px4_nonsense}
    return "silent", {}


def _version(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    version = facts.px4_version
    if version is None:
        return "unknown", {}
    if plausible_version(version) is None:
        return "nonsense", {"version": _dotted(version)}

    oldest, newest = MEASURED_VERSIONS
    type_words = vehicle.type if vehicle.type else "the vehicle"
    words: dict[str, object] = {
        "version": _dotted(version),
        "oldest": _dotted(oldest),
        "newest": _dotted(newest),
        "file": vehicle.px4_version,
        "type": type_words,
    }
    if not oldest <= version <= newest:
        return "unmeasured", words

    major, minor = vehicle.px4_version.split(".")
    file_version: Version = (int(major), int(minor))
    expected_s = lag_s(file_version, vehicle.px4_params)
    actual_s = lag_s(version, vehicle.px4_params)
    words |= {"expected": expected_s, "actual": actual_s}
    if abs(actual_s - expected_s) > LAG_ERROR_S:
        return "other lag", words
    if version != file_version:
        return "same lag", words
    return OK, words


def _dotted(version: Version) -> str:
    return ".".join(map(str, version))


def _link(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    if facts.attitude_hz is None:
        return SKIP, {"reason": "in the first second"}

    words = {"rate": facts.attitude_hz}
    if facts.attitude_hz < MIN_ATTITUDE_HZ:
        return "too slow", words
    if facts.attitude_hz < USUAL_ATTITUDE_HZ:
        return "slower than usual", words
    return OK, words


def _port(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_autopilot and facts.newest_refused:
        refused = facts.refused
        source = "it"  # the port, which the sentence names before "from it"
        if refused.source:
            source = refused.source
        return "strangers", {
            "count": refused.count,
            "reason": _REASONS[refused.newest],
            "source": source,
        }

    listens = vehicle.autopilot.startswith("udpin://")
    if listens and host_of(vehicle.autopilot) in _EVERY_NETWORK:
        return "open to networks", {}
    return PASSED


def _signing(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    if vehicle.mavlink_signing:
        words = {"says": "PX4 and this agent sign their messages."}
        if facts.has_signing_clock_behind:
            return "clock behind", words
        return OK, words
    if facts.is_signed:
        return "keyless", {"name": vehicle.name}

    version = plausible_version(facts.px4_version)
    takes_keys = version is None or version >= SIGNING_SINCE
    links = []
    for link in (vehicle.autopilot, vehicle.direct):
        if link and is_on_network(link):
            links.append(link)
    if links and takes_keys:
        return "takes any key", {"links": " and ".join(links), "fleet": fleet.path}
    return OK, {"says": "No network is known that could give PX4 a key."}


def _alone(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    # a duplicate, see DuplicateAgents
    if facts.has_duplicate:
        return "duplicate", {}
    return PASSED


def _health(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    if facts.is_failsafe:
        return "failsafe", {}

    required = [name for name, is_required in facts.unhealthy if is_required]
    if required:
        return "unhealthy", {"sensors": ", ".join(required)}
    others = [name for name, is_required in facts.unhealthy if not is_required]
    if others:
        return "not required", {"sensors": ", ".join(others)}
    return PASSED


def _disarmed(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    if not facts.has_landed_report:
        return "not known", {}
    if facts.is_airborne:
        return "airborne", {}
    if facts.is_armed:
        return "armed", {}
    return PASSED


def _failsafe(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    conditions = facts.conditions - _OF_OTHER_RULES
    if facts.has_wrong_clock:
        conditions -= _OF_A_WRONG_CLOCK
    names = [
        condition.value
        for condition in in_order(conditions)
        if TABLE[Situation.GROUND, condition] is Action.REFUSE
    ]
    if not names:
        return PASSED
    if names == [Condition.DISK_FULL.value]:
        return "disk full", {}
    text = ", ".join(names)
    return "condition holds", {"conditions": capitalised(text)}


def _parameters(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    # this check needs only the fleet file, so it comes before PX4 answers
    weak = weakened(fleet, vehicle)
    if weak:
        return "weakened", {"problems": " ".join(weak)}
    if not facts.has_autopilot:
        return NO_PX4
    if facts.param_problems is None:
        return "unread", {}
    if facts.param_problems:
        return "differ", {"problems": " ".join(facts.param_problems), "fleet": fleet.path}
    return PASSED


AUTOPILOT_RULES = rules(
    {
        "px4": _px4,
        "version": _version,
        "link": _link,
        "port": _port,
        "signing": _signing,
        "alone": _alone,
        "health": _health,
        "disarmed": _disarmed,
        "failsafe": _failsafe,
        "parameters": _parameters,
    },
    AUTOPILOT_SILENT_S=AUTOPILOT_SILENT_S,
    HEARTBEAT_SILENT_S=HEARTBEAT_SILENT_S,
    MIN_ATTITUDE_HZ=MIN_ATTITUDE_HZ,
    USUAL_ATTITUDE_HZ=USUAL_ATTITUDE_HZ,
    LAG_ERROR_MS=1e3 * LAG_ERROR_S,
)
