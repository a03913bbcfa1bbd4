"""Tables of the code as Markdown, for docs/."""

from __future__ import annotations

from pymavlink.dialects.v20 import common

from groundstation.alarms import alarm_table
from onboard.autopilot import Version
from onboard.bus.topics import Topic
from onboard.flight import flight_table
from onboard.flight.flight_table import Effect, Predicate
from onboard.flight.types import FlightStep
from onboard.plain_text import capitalised
from onboard.preflight import all_rules
from onboard.px4 import own_failsafes, required_params
from onboard.px4.own_failsafes import OwnFailsafe, Treatment
from onboard.px4.required_params import RequiredParam
from onboard.safety import failsafe_table
from onboard.safety.failsafe_table import Condition, Situation
from onboard.security.node_roles import GRANTS, Grant, NodeRole
from onboard.supervision import condition_table
from sitl.mavlink.codec import LAYOUTS
from sitl.mavlink.commands import COMMANDS
from sitl.mavlink.link import REACTIONS
from sitl.mavlink.streams import BUILDERS


def failsafes() -> str:
    """Return the failsafe table for docs/failsafe.md."""
    lines = [
        _line("condition", *(situation.value for situation in Situation)),
        "|---" * (len(Situation) + 1) + "|",
    ]
    for condition in Condition:
        actions = (failsafe_table.TABLE[situation, condition].name for situation in Situation)
        lines.append(_line(condition.value, *map(_words, actions)))
    return "\n".join(lines)


def conditions() -> str:
    """Return how long each condition has to last for docs/failsafe.md."""
    lines = [_line("condition", "checked", "must hold for"), "|---" * 3 + "|"]
    for row in condition_table.ROWS:
        for cause in row.causes:
            checked = "ten times a second" if cause.is_slow else "at every tick"
            lines.append(_line(row.condition.value, checked, _duration(cause)))
    return "\n".join(lines)


def _duration(cause: condition_table.Cause) -> str:
    words = []
    if cause.checks > 1:
        words.append(f"{cause.checks} checks in a row")
    if isinstance(cause.over_s, str):
        words.append(f"more than `{cause.over_s}`")
    elif cause.over_s is not None:
        words.append(f"more than {cause.over_s:g} s")
    return " and ".join(words) or "one check"


def steps() -> str:
    """Return the steps of a flight for docs/flight.md."""
    lines = [
        _line(
            "step",
            "state",
            "shown beside it",
            "situation for failsafes",
            "control mode",
            "setpoints",
        )
    ]
    lines.append("|---" * 6 + "|")
    for step in FlightStep:
        streams = "yes" if step.is_streaming else "no"
        mode = _words(step.control_mode.name)
        lines.append(
            _line(_words(step.name), step.state, step.text, step.situation.value, mode, streams)
        )
    return "\n".join(lines)


def flight() -> str:
    """Return the table of a flight for docs/flight.md."""
    lines = [
        _line("step", "event", "when", "next step", "request to PX4", "goal", "the order ends"),
        "|---" * 7 + "|",
    ]
    for row in flight_table.ROWS:
        cells = (
            "any"
            if len(row.steps) == len(FlightStep)
            else ", ".join(_words(step.name) for step in row.steps),
            row.event.value,
            _function_words(row.when),
            "" if row.to is None else _words(row.to.name),
            "" if row.request is None else type(row.request).__name__,
            _function_words(row.effect),
            "" if row.ends is None else row.ends[0],
        )
        lines.append(_line(*cells))
    return "\n".join(lines)


def alarms() -> str:
    """Return the alarms for docs/alarms.md."""
    lines = [
        "| condition | flying | on the ground | sentence | advice in flight | advice |",
        "|---|---|---|---|---|---|",
    ]
    for kind, row in alarm_table.TABLE.items():
        sentence = row.sentence.replace("{who}", "mav1").replace("{what}", "…")
        lines.append(
            _line(
                kind.value,
                row.in_flight.name.lower(),
                row.on_ground.name.lower(),
                sentence,
                row.advice_in_flight,
                row.advice,
            )
        )
    return "\n".join(lines)


def preflight() -> str:
    """Return every preflight rule with its faults and remedies for docs/preflight.md."""
    lines: list[str] = []
    for rule in all_rules.RULES:
        lines += [f"### {rule.name}", "", rule.demand, "", "| says | what to do |", "|---|---|"]
        for fault in rule.faults.values():
            lines.append(
                f"| {'' if fault.is_advice else '**no-go** '}{fault.sentence} | {fault.remedy} |"
            )
        lines.append("")
    return "\n".join(lines).strip()


def parameters() -> str:
    """Return the built-in parameters for docs/deployment.md."""
    lines = _parameter_table(required_params.BUILT_IN)
    lines.append(
        "| `MPC_THR_HOVER` | `hover_thrust_frac` | allowed | PX4's own hold and land begin with "
        "this throttle. |"
    )
    return "\n".join(lines)


def camera_parameters() -> str:
    """Return the parameters of a vehicle with a camera for docs/deployment.md."""
    return "\n".join(_parameter_table(required_params.WITH_CAMERA))


def _parameter_table(params: tuple[RequiredParam, ...]) -> list[str]:
    lines = ["| parameter | value | take-off without it | why |", "|---|---|---|---|"]
    for param in params:
        without = "allowed" if param.is_advice else "**refused**"
        restart = " Restart PX4 after it." if param.needs_restart else ""
        versions = _versions(param.since, param.before)
        if versions:
            versions = f" PX4 {versions}."
        lines.append(
            f"| `{param.name}` | {_value(param)} | {without} | {param.reason}.{versions}{restart} |"
        )
    return lines


def _versions(since: Version, before: Version) -> str:
    if since > own_failsafes.FIRST:
        return f"v{since[0]}.{since[1]} and newer"
    if before < own_failsafes.LAST:
        return f"before v{before[0]}.{before[1]}"
    return ""


def _value(param: RequiredParam) -> str:
    bound = next(
        (own.bound for own in own_failsafes.demanded_parameters() if own.name == param.name), ""
    )
    words = param.words
    return f"{words}, or what lies {bound}" if bound else words


def own_failsafe_table() -> str:
    """Return what PX4 does of its own accord in OFFBOARD for docs/px4.md."""
    lines = [
        _line("PX4's failsafe", "what PX4 does in OFFBOARD", "how this fleet treats it"),
        "|---" * 3 + "|",
    ]
    for failsafe in own_failsafes.OWN_FAILSAFES:
        versions = _versions(failsafe.since, failsafe.before)
        named = capitalised(failsafe.holds)
        if failsafe.flags:
            named += f" (`{failsafe.flags[0]}`)"
        if versions:
            named += f"; {versions}"
        lines.append(_line(named, failsafe.acts, _treatment(failsafe)))
    return "\n".join(lines)


def _treatment(failsafe: OwnFailsafe) -> str:
    demands = []
    for own in failsafe.parameters:
        if own.demand is None:
            continue
        param = next(param for param in required_params.FAILSAFES if param.name == own.name)
        versions = _versions(own.since, own.before)
        demands.append(f"`{own.name}` = {_value(param)}{f' ({versions})' if versions else ''}")

    parts = []
    if failsafe.treated is Treatment.NET:
        parts.append(f"PX4's own net: {failsafe.why}")
    if demands:
        parts.append(f"demanded: {'; '.join(demands)}")
    if failsafe.rows:
        rows = ", ".join(condition.value for condition in failsafe.rows)
        parts.append(f"row of the failsafe table: {rows}")
    return ". ".join(capitalised(part) for part in parts)


def emulated() -> str:
    """Return what the emulated PX4 takes and sends, for docs/emulator.md."""
    numbers = sorted(COMMANDS)
    commands = [f"{_command_name(number)} ({number})" for number in numbers]
    lines = [
        _line("", "which"),
        "|---|---|",
        _line("commands (COMMAND_LONG, COMMAND_INT)", ", ".join(commands)),
        _line("messages that it takes", ", ".join(sorted(REACTIONS))),
        _line(
            "messages that it streams or sends on request",
            ", ".join(sorted(LAYOUTS[number].name for number in BUILDERS)),
        ),
    ]
    return "\n".join(lines)


def _command_name(number: int) -> str:
    entry = common.enums["MAV_CMD"].get(number)
    return str(number) if entry is None else entry.name.removeprefix("MAV_CMD_")


def roles() -> str:
    """Return the table of roles and topics for docs/keys.md."""
    lines = [
        _line("topic", *(f"`{role.value}`" for role in NodeRole)),
        "|---" * (len(NodeRole) + 1) + "|",
    ]
    for topic in Topic:
        lines.append(
            _line(f"`{topic.value}`", *(_granted(topic, GRANTS[role]) for role in NodeRole))
        )
    return "\n".join(lines)


def _granted(topic: Topic, grant: Grant) -> str:
    verbs = {"publishes": grant.publishes, "answers": grant.answers, "asks": grant.asks}
    words = [
        f"{verb} {', '.join(map(_whose, names[topic]))}"
        for verb, names in verbs.items()
        if topic in names
    ]
    if topic is Topic.ALIVE:
        words.append(f"tells {', '.join(map(_whose, grant.tokens))}")
    return "; ".join([*words, *(["reads"] if topic in grant.reads else [])]) or "-"


def _whose(pattern: str) -> str:
    return {"{own}": "its own", "*": "any"}.get(pattern, f"`{pattern.replace('$*', '...')}`")


def _line(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


def _function_words(function: Predicate | Effect | None) -> str:
    return "" if function is None else _words(function.__name__)
