"""Rules of preflight about PX4: link, health, arming, failsafes and parameters. Pure."""

from __future__ import annotations

from onboard.autopilot import MEASURED_VERSIONS, SIGNING_SINCE, Version, plausible_version
from onboard.avoidance.prediction import LAG_ERROR_S
from onboard.config.endpoints import host_of, is_on_network
from onboard.config.fleet import FleetConfig, Vehicle
from onboard.preflight.attitude_lag import lag_s
from onboard.preflight.preflight_facts import HEARTBEAT_SILENT_S, PreflightFacts
from onboard.preflight.preflight_rule import FINE, NO_PX4, OK, SKIP, Judgement, rules
from onboard.safety.failsafe_table import TABLE, Action, Condition, Situation, in_order
from onboard.safety.limits import AUTOPILOT_SILENT_S

# reasons for which a packet of a vehicle that signs is not let in
_OF_SIGNING = ("unsigned", "forged", "old")
_EVERY_NETWORK = ("", "0.0.0.0", "::", "[::]")
_REASONS = {
    "malformed": "no MAVLink",
    "strangers": "under PX4's ids, from another address",
    "unsigned": "not signed",
    "forged": "signed with another key",
    "old": "signed, but older than others: a replay",
}
LEAST_ATTITUDE_HZ, USUAL_ATTITUDE_HZ = 20.0, 35.0

# conditions that another rule shows; for SHUTDOWN, the refusal of the order itself does
_OF_OTHER_RULES = frozenset(
    {
        *(Condition.POSITION_STALE, Condition.POSITION_LOST, Condition.POSITION_LOST_LONG),
        *(Condition.AUTOPILOT_SILENT, Condition.AUTOPILOT_FROZEN),
        *(
            Condition.HEARTBEAT_LOST,
            Condition.TWIN,
            Condition.SHUTDOWN,
            Condition.BUS_LOST,
            Condition.BUS_LOST_LONG,
        ),
        *(
            Condition.SEPARATION_BREACHED,
            Condition.CONFIG_DIFFERS,
            Condition.BATTERY_WARNING,
            Condition.BATTERY_LOW,
        ),
        *(Condition.BATTERY_UNKNOWN, Condition.LANDED_UNKNOWN),
        *(Condition.FENCE_BREACH, Condition.FENCE_BREACH_LONG),
    }
)


def _px4(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_autopilot:
        return OK, {"age": facts.heartbeat_age_s}
    if facts.newest_refused in _OF_SIGNING:
        return facts.newest_refused, {"name": vehicle.name, "fleet": fleet.path}
    return ("nonsense", {"sentence": facts.px4_nonsense}) if facts.px4_nonsense else ("silent", {})


def _version(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    if facts.px4_version is None:
        return "unknown", {}
    if plausible_version(facts.px4_version) is None:
        return "nonsense", {"version": _dotted(facts.px4_version)}
    oldest, newest = MEASURED_VERSIONS
    words: dict[str, object] = {"version": _dotted(facts.px4_version), "oldest": _dotted(oldest)}
    words |= {
        "newest": _dotted(newest),
        "file": vehicle.px4_version,
        "type": vehicle.type or "the vehicle",
    }
    if not oldest <= facts.px4_version <= newest:
        return "unmeasured", words
    file_version: Version = (1, int(vehicle.px4_version.partition(".")[2]))
    expected_s, actual_s = (
        lag_s(version, vehicle.px4_params) for version in (file_version, facts.px4_version)
    )
    words |= {"expected": expected_s, "actual": actual_s}
    if abs(actual_s - expected_s) > LAG_ERROR_S:
        return "other", words
    return (OK if facts.px4_version == file_version else "alike"), words


def _dotted(version: Version) -> str:
    return ".".join(map(str, version))


def _link(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    if facts.attitude_hz is None:
        return SKIP, {"reason": "in the first second"}
    is_slow, is_low = facts.attitude_hz < LEAST_ATTITUDE_HZ, facts.attitude_hz < USUAL_ATTITUDE_HZ
    return ("slow" if is_slow else "low" if is_low else OK), {"rate": facts.attitude_hz}


def _port(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if facts.has_autopilot and facts.newest_refused:
        refused = facts.refused
        return "others", {
            "count": refused.count,
            "reason": _REASONS[refused.newest],
            "source": refused.source or "it",
        }
    host = host_of(vehicle.autopilot)
    return (
        "open" if vehicle.autopilot.startswith("udpin://") and host in _EVERY_NETWORK else OK
    ), {}


def _signing(facts: PreflightFacts, fleet: FleetConfig, vehicle: Vehicle) -> Judgement:
    if not facts.has_autopilot:
        return NO_PX4
    if vehicle.mavlink_signing:
        return ("clock" if facts.has_signing_clock_behind else OK), {
            "says": "PX4 and this agent sign their messages."
        }
    if facts.is_signed:
        return "keyless", {"name": vehicle.name}
    version = plausible_version(facts.px4_version)
    links = [link for link in (vehicle.autopilot, vehicle.direct) if link and is_on_network(link)]
    takes_keys = version is None or version >= SIGNING_SINCE
    words = {"links": " and ".join(links), "fleet": fleet.path}
    return ("open" if links and takes_keys else OK), words | {
        "says": "No network is known that could give PX4 a key."
    }


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
    if not facts.is_landed_told:
        return "untold", {}
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
    LEAST_ATTITUDE_HZ=LEAST_ATTITUDE_HZ,
    USUAL_ATTITUDE_HZ=USUAL_ATTITUDE_HZ,
    LAG_ERROR_MS=1e3 * LAG_ERROR_S,
)
