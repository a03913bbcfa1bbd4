"""Facts of missing setpoints: delay of the failsafe, COM_OBL_RC_ACT, return of setpoints."""

from __future__ import annotations

from sitl.conformance.fact_group import FactGroup
from sitl.conformance.facts import Fact, FactReport, facts, number, word
from sitl.conformance.hover import Hover, airborne, fast_streams, grounded, settle
from sitl.conformance.measurements import NOT_MEASURED, descent_speed_m_s, sent_or_not
from sitl.conformance.vehicle_client import ARM, VehicleClient, other_system_id, quaternion

_HEIGHT_M = 3.0
_HIGHEST_M = 1.5  # greatest height at which the speed of the descent is measured
_TEXT = "Failsafe activated"

# COM_OBL_RC_ACT -> mode that follows a loss, in the order of the flights.
_ACTIONS = {1: "ALTCTL", 3: "AUTO.RTL", 4: "AUTO.LAND", 5: "AUTO.LOITER", 0: "POSCTL"}
_DEFAULT_ACTION = 0
# Facts that are measured in the flight with the default action.
_OF_DEFAULT_ACTION = (
    "loss.status",
    "loss.base-mode",
    "loss.text",
    "loss.severity",
    "loss.event",
)


def _action_facts(action: int, mode: str) -> tuple[Fact, ...]:
    name = f"loss.action-{action}"
    says = f"COM_OBL_RC_ACT {action}"
    return (
        word(name, "6", f"{says}: mode", mode),
        number(f"{name}-time", "6", f"{says}: after the last setpoint", 0.97, 1.25, "s"),
        word(f"{name}-return", "6", f"{says}: when setpoints return", "OFFBOARD"),
    )


AIR = (
    word("loss.short-gap", "6", "setpoints pause for 0.8 s", "nothing"),
    *(fact for action, mode in _ACTIONS.items() for fact in _action_facts(action, mode)),
    word("loss.status", "6", "system_status in failsafe", "CRITICAL"),
    word("loss.base-mode", "5", "base_mode in POSCTL, armed", "209"),
    word("loss.text", "6", "text", repr("Failsafe activated\t")),
    word("loss.severity", "6", "its severity", "2"),
    word("loss.event", "6", "EVENT (410) about it", "sent"),
    number(
        "loss.timeout-follows", "6", "COM_OF_LOSS_T 0.5: after the last setpoint", 0.47, 0.75, "s"
    ),
    number("loss.wrong-target", "5", "setpoints for another system do not count", 0.97, 1.25, "s"),
)
DESCENT = facts("loss", "descent")
GROUND = facts("loss", "ground")


def run(client: VehicleClient, report: FactReport) -> None:
    """Pause setpoints, stop them, stop them until the landing, then stop them on the ground."""
    client.greet(as_ground_station=True)
    if report.wants(*(fact.name for fact in (*AIR, *DESCENT))):
        hover = airborne(client, _HEIGHT_M)
        _in_the_air(client, report, hover)
        if report.wants(*(fact.name for fact in DESCENT)):
            _descend(client, report, hover)
    if report.wants("loss.ground-*"):
        _on_the_ground(client, report)


def _in_the_air(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    if report.wants("loss.short-gap"):
        _short_gap(client, report, hover)

    for action in _ACTIONS:
        measured_facts = [f"loss.action-{action}*"]
        if action == _DEFAULT_ACTION:
            measured_facts.extend(_OF_DEFAULT_ACTION)
        if report.wants(*measured_facts):
            _act(client, report, hover, action)

    if report.wants("loss.timeout-follows"):
        _other_timeout(client, report, hover)
    if report.wants("loss.wrong-target"):
        _wrong_target(client, report, hover)


def _short_gap(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    since_s = _stop(client, hover)
    client.wait(0.8)
    _resume(client, hover)
    client.next_heartbeat(2)

    is_quiet = client.text(_TEXT, since_s) is None and client.mode == "OFFBOARD"
    if is_quiet:
        report.add("loss.short-gap", "nothing")
    else:
        report.add("loss.short-gap", f"failsafe, {client.mode}")


def _other_timeout(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    client.params.set("COM_OF_LOSS_T", 0.5)
    since_s = _stop(client, hover)
    report.add("loss.timeout-follows", _until_failsafe(client, since_s))

    _resume(client, hover)
    client.params.restore()
    client.next_heartbeat()
    settle(client, hover)


def _wrong_target(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    since_s = _stop(client, hover)
    level = quaternion(0.0, 0.0, hover.yaw_rad)
    target = other_system_id(client)
    client.stream(lambda: client.attitude(level, hover.thrust, target=target))
    report.add("loss.wrong-target", _until_failsafe(client, since_s))

    _resume(client, hover)
    client.next_heartbeat()
    settle(client, hover)


def _stop(client: VehicleClient, hover: Hover) -> float:
    """Send a last setpoint, which is level and which PX4 holds; return its time."""
    level = quaternion(0.0, 0.0, hover.yaw_rad)
    client.attitude(level, hover.thrust)
    client.stream(None)
    return client.now_s


def _resume(client: VehicleClient, hover: Hover) -> None:
    hover.hold_here()
    client.stream(hover)


def _until_failsafe(client: VehicleClient, since_s: float) -> float:
    return client.delay_s(_TEXT, since_s, wait_s=2.5)


def _act(client: VehicleClient, report: FactReport, hover: Hover, action: int) -> None:
    """Set an action and stop sending; report the result, and return to OFFBOARD."""
    client.params.set("COM_OBL_RC_ACT", action)
    since_s = _stop(client, hover)
    report.add(f"loss.action-{action}-time", _until_failsafe(client, since_s))
    client.next_heartbeat()
    report.add(f"loss.action-{action}", client.mode)
    if action == _DEFAULT_ACTION:
        _default_action(client, report, since_s)

    _resume(client, hover)
    client.wait(0.1)
    client.next_heartbeat()
    report.add(f"loss.action-{action}-return", client.mode)

    if client.mode != "OFFBOARD":
        client.set_mode("OFFBOARD")
        client.next_heartbeat()
    client.params.restore()
    settle(client, hover)


def _default_action(client: VehicleClient, report: FactReport, since_s: float) -> None:
    report.add("loss.status", client.status)
    report.add("loss.base-mode", str(client.newest("HEARTBEAT").base_mode))

    report.add("loss.text", client.quote(_TEXT, since_s))
    text = client.text(_TEXT, since_s)
    severity = "none"
    if text is not None:
        severity = str(text.severity)
    report.add("loss.severity", severity)
    # The failsafe starts about 1 s after the last setpoint. Count events from shortly before that.
    report.add("loss.event", sent_or_not(client.received.of("EVENT", since_s + 0.9)))


def _descend(client: VehicleClient, report: FactReport, hover: Hover) -> None:
    hover.to_height(2.6)
    settle(client, hover)

    since_s = _stop(client, hover)
    _until_failsafe(client, since_s)
    client.next_heartbeat()
    if client.mode == "POSCTL":
        _descend_blindly(client, report, hover, since_s)
    else:  # PX4 returns home, at a height that depends on the distance
        for name in ("descent", "landed", "disarmed"):
            report.add(f"loss.{name}", NOT_MEASURED)

    report.add("loss.mode-after", client.mode)
    report.add("loss.status-after", client.status)
    report.add("loss.arming-after", client.command(ARM, 1.0))


def _descend_blindly(
    client: VehicleClient, report: FactReport, hover: Hover, since_s: float
) -> None:
    disarmed_s = client.delay_s("Disarmed by", since_s, wait_s=20.0)
    positions = client.received.of("LOCAL_POSITION_NED", since_s)
    report.add("loss.descent", descent_speed_m_s(positions, hover.ground_z, top_m=_HIGHEST_M))

    landed_s = client.delay_s("Landing detected", since_s)
    report.add("loss.landed", landed_s)
    report.add("loss.disarmed", disarmed_s - landed_s)
    client.next_heartbeat(2)


def _on_the_ground(client: VehicleClient, report: FactReport) -> None:
    """Pause the setpoints of an armed vehicle on the ground, and report its modes."""
    grounded(client)
    fast_streams(client)
    hover = Hover(client)
    client.stream(hover)
    client.wait(0.3)
    client.set_mode("OFFBOARD")
    client.command(ARM, 1.0)
    client.wait(0.5)

    client.stream(None)
    _until_failsafe(client, client.now_s)
    client.next_heartbeat()
    report.add("loss.ground-mode", client.mode)
    client.wait(5.0)
    report.add("loss.ground-armed", client.arming_state)

    client.stream(hover)
    client.wait(0.1)
    client.next_heartbeat()
    report.add("loss.ground-return", client.mode)

    client.command(ARM, 0.0)
    client.next_heartbeat()


FACT_GROUP = FactGroup("setpoints stop", (*AIR, *DESCENT, *GROUND), run)
