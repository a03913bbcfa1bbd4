"""The emulator against the facts, and the command that asks them."""

from __future__ import annotations

import fnmatch
import math
import re
import socket
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from groundstation.cli import main
from sitl.conformance import suite
from sitl.conformance.facts import (
    CHANGES,
    VERSIONS,
    Fact,
    FactReport,
    FactVerdict,
    facts_of,
    matching,
    nearest,
    number,
    word,
)
from sitl.conformance.suite import FACTS, Terms, check
from tests.sitl.conformance.exceptions import DIFFERENCES
from tests.sitl.conformance.facts_page import PAGE, whole_check
from tests.sitl.conformance.virtual import VirtualPort, Wires

pytestmark = pytest.mark.timeout(400)


def _differing(report: FactReport) -> dict[str, str]:
    return {
        name: f"{finding.measured} instead of {finding.fact.expected} {finding.reason}"
        for name, finding in report.results.items()
        if finding.verdict is not FactVerdict.AGREES and name not in DIFFERENCES
    }


@pytest.mark.long
@pytest.mark.parametrize("px4", VERSIONS)
def test_the_emulator_agrees_with_every_fact_of_each_version_but_the_documented_ones(
    px4: str,
) -> None:
    report = whole_check(px4)
    assert set(report.results) == {fact.name for fact in FACTS}
    assert not _differing(report)


@pytest.mark.long
@pytest.mark.parametrize("px4", VERSIONS)
@pytest.mark.parametrize("seed", range(2, 6))
def test_the_facts_do_not_depend_on_the_seed(seed: int, px4: str) -> None:
    assert not _differing(whole_check(px4, seed))


def test_documented_differences_are_facts_with_a_reason() -> None:
    assert set(DIFFERENCES) <= {fact.name for fact in FACTS}
    assert all(len(reason) > 10 for reason in DIFFERENCES.values())


def test_the_page_shows_every_fact_and_every_difference() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert [fact.name for fact in FACTS if f"| `{fact.name}` |" not in text] == []
    assert [name for name in DIFFERENCES if f"- `{name}`: " not in text] == []


def test_what_changed_in_a_version_names_facts_and_accepts_other_values_than_before() -> None:
    assert VERSIONS == ("1.16", "1.17", "1.18")
    names = [fact.name for fact in FACTS]
    assert [
        pattern
        for changes in CHANGES.values()
        for pattern in changes
        if not fnmatch.filter(names, pattern)
    ] == []
    before = facts_of("1.16", FACTS)
    after = facts_of("1.18", FACTS)
    assert before == {fact.name: fact for fact in FACTS}
    assert not after["mode.two-acks"].accepts("ACCEPTED, ACCEPTED")
    assert after["mode.two-acks"].accepts("ACCEPTED")
    assert after["loss.landed"].accepts(math.nan)
    assert not after["loss.landed"].accepts(8.0)
    assert not before["loss.landed"].accepts(math.nan)


@pytest.mark.parametrize(
    ("reported", "version", "said"),
    [
        ((1, 17), "1.17", ""),
        ((1, 19), "1.18", "never measured"),
        ((1, 15), "1.16", "never measured"),
        (None, "1.16", "no"),
    ],
)
def test_an_autopilot_is_judged_by_the_version_that_it_reports(
    reported, version: str, said: str
) -> None:
    assert nearest(reported)[0] == version
    assert said in nearest(reported)[1]
    assert bool(said) == bool(nearest(reported)[1])


def test_measurements_from_before_the_version_is_known_are_judged_by_it() -> None:
    asked = FactReport(
        matching(FACTS, ["stream.heartbeat", "quirk", "request.version"]), is_version_known=False
    )
    lines: list[str] = []
    check(Wires().companion(), None, asked, Terms(), lines.append)
    assert "it is PX4 v1.16" in lines
    assert {finding.verdict for finding in asked.results.values()} == {FactVerdict.AGREES}


@pytest.mark.parametrize(
    ("flown", "asked", "differing"),
    [
        (
            "1.16",
            "1.17",
            {"request.version", "param.MC_ROLL_P", "wire.unasked-others", "step.roll-10-t63"},
        ),
        (
            "1.16",
            "1.18",
            {"request.version", "mode.two-acks", "quirk.battery-current", "step.roll-10-t63"},
        ),
        (
            "1.18",
            "1.16",
            {"request.version", "mode.two-acks", "setpoint.ignored-thrust", "stick.fast"},
        ),
    ],
)
def test_an_emulator_of_one_version_differs_from_the_facts_of_another(
    flown: str, asked: str, differing
) -> None:
    report = FactReport(matching(facts_of(asked, FACTS).values(), sorted(differing)))
    check(
        Wires(px4=flown).companion(), None, report, Terms(may_turn_motors=True), lambda line: None
    )
    assert {
        name for name, finding in report.results.items() if finding.verdict is FactVerdict.DIFFERS
    } == differing


def test_no_two_facts_share_a_name_and_each_says_what_it_accepts() -> None:
    assert len({fact.name for fact in FACTS}) == len(FACTS) > 300
    assert all(fact.allowed or fact.low <= fact.high for fact in FACTS)


def test_a_vehicle_that_does_not_look_simulated_is_never_armed() -> None:
    wires = Wires()
    armed: list[bool] = []

    def outgoing(frame: bytes) -> list[bytes]:
        armed.append(wires.emulator.autopilots[0].is_armed)
        return [] if int.from_bytes(frame[7:10], "little") == 115 else [frame]  # no ground truth

    wires.outgoing = outgoing
    asked = FactReport(matching(FACTS, ["arm", "step.thrust", "ack", "param.COM_OF_LOSS_T"]))
    check(wires.companion(), None, asked, Terms(), lambda line: None)
    verdicts = {name: finding.verdict for name, finding in asked.results.items()}
    assert not any(armed)
    assert verdicts["arm.accepted"] is verdicts["step.thrust"] is FactVerdict.SKIPPED
    assert verdicts["ack.unknown-command"] is verdicts["param.COM_OF_LOSS_T"] is FactVerdict.AGREES


def test_facts_differ_that_a_vehicle_left_unmeasured_by_falling_silent() -> None:
    wires = Wires()
    wires.outgoing = lambda frame: [] if wires.emulator.time_s > 20.0 else [frame]
    asked = FactReport(matching(FACTS, ["loss", "param.COM_OF_LOSS_T"]))
    check(wires.companion(), None, asked, Terms(may_turn_motors=True), lambda line: None)
    assert asked.results["param.COM_OF_LOSS_T"].verdict is FactVerdict.AGREES
    assert asked.results["loss.ground-armed"].verdict is FactVerdict.DIFFERS
    assert "silent" in asked.results["loss.ground-armed"].reason


def test_parameters_are_what_they_were_after_a_check() -> None:
    wires = Wires()
    before = dict(wires.emulator.autopilots[0].params.values)
    asked = FactReport(
        matching(
            FACTS, ["param.set-float", "loss.action-4", "loss.timeout-follows", "vision.flags"]
        )
    )
    check(wires.companion(), None, asked, Terms(may_turn_motors=True), lambda line: None)
    assert dict(wires.emulator.autopilots[0].params.values) == before
    assert not wires.emulator.autopilots[0].is_armed


def test_an_interrupted_check_puts_the_vehicle_down_and_its_parameters_back() -> None:
    wires = Wires()
    before = dict(wires.emulator.autopilots[0].params.values)
    interrupted: list[float] = []

    def incoming(frame: bytes) -> list[bytes]:
        autopilot = wires.emulator.autopilots[0]
        if (
            autopilot.params["COM_OBL_RC_ACT"] == 4
            and autopilot.mode.name == "LAND"
            and not interrupted
        ):
            interrupted.append(wires.emulator.time_s)
            raise KeyboardInterrupt
        return [frame]

    wires.incoming = incoming
    asked = FactReport(matching(FACTS, ["loss.action-4", "loss.action-5"]))
    with pytest.raises(KeyboardInterrupt):
        check(wires.companion(), None, asked, Terms(may_turn_motors=True), lambda line: None)
    assert interrupted
    assert not wires.emulator.autopilots[0].is_armed
    assert dict(wires.emulator.autopilots[0].params.values) == before


class _Quick:
    """A port whose clock sees the vehicle run four times as fast as real time."""

    def __init__(self, port: VirtualPort) -> None:
        self._port = port

    def now_s(self) -> float:
        return self._port.now_s() / 4.0

    def receive(self, timeout_s: float) -> list[bytes]:
        return self._port.receive(4.0 * timeout_s)

    def send(self, datagram: bytes) -> None:
        self._port.send(datagram)

    def another_sender(self) -> _Quick:
        return _Quick(self._port.another_sender())

    def close(self) -> None:
        self._port.close()


def test_a_simulator_that_runs_faster_than_time_is_judged_in_its_own_time() -> None:
    facts = [
        "boot",
        "stream.attitude",
        "heartbeat",
        "rate.odometry",
        "arm",
        "loss.action-4",
        "hover",
        "clock.pace",
    ]
    asked = FactReport(matching(FACTS, facts))
    client = check(_Quick(Wires().companion()), None, asked, Terms(), lambda line: None)
    differing = {
        name: f.measured for name, f in asked.results.items() if f.verdict is FactVerdict.DIFFERS
    }
    assert client.clock.pace == pytest.approx(4.0, rel=0.02)
    assert differing == {}
    assert asked.results["clock.pace"].verdict is FactVerdict.SKIPPED


@pytest.mark.parametrize(
    ("fact", "measured", "agrees"),
    [
        (number("a", "1", "x", 1.0, 2.0, "s"), 1.5, True),
        (number("a", "1", "x", 1.0, 2.0, "s"), 2.1, False),
        (number("a", "1", "x", 1.0, 2.0, "s"), float("nan"), False),
        (word("a", "1", "x", "yes", "perhaps"), "perhaps", True),
        (word("a", "1", "x", "yes"), "no", False),
    ],
)
def test_a_fact_accepts_what_lies_within_its_bounds(
    fact: Fact, measured: float | str, agrees: bool
) -> None:
    asked = FactReport({"a": fact})
    asked.add("a", measured)
    assert (asked.results["a"].verdict is FactVerdict.AGREES) == agrees


def test_the_command_lists_what_it_would_check(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sitl-check", "--list", "--only", "heartbeat", "loss.action-*"]) == 0
    out = capsys.readouterr().out
    assert "heartbeat.interval-max" in out
    assert "loss.action-0-time" in out
    assert "takeoff" not in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["udpin://127.0.0.1:14540", "--only", "nonsense"], "Topics: "),
        (["tcp://127.0.0.1:5760"], "is no endpoint"),
        (["udpin://127.0.0.1:99999"], "is no endpoint"),
        ([], "which endpoint?"),
    ],
)
def test_wrong_input_is_refused_in_words(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sitl-check", *words]) == 2
    assert said in capsys.readouterr().err


def test_a_port_in_use_is_refused_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        assert main(["sitl-check", f"udpin://127.0.0.1:{port}"]) == 2
    assert f"port {port} on 127.0.0.1 cannot be bound" in capsys.readouterr().err


def test_the_suite_shares_no_code_with_the_emulator() -> None:
    folder = Path(suite.__file__).parent
    imports = [
        line
        for path in folder.glob("*.py")
        for line in path.read_text().splitlines()
        if "import" in line
    ]
    foreign = [
        line for line in imports if re.match(r"\s*(from|import) (sitl|onboard|groundstation)", line)
    ]
    assert foreign
    assert [line for line in foreign if not line.startswith("from sitl.conformance")] == []


def test_an_autopilot_that_is_no_px4_is_not_taken_for_the_vehicle() -> None:
    mav = common.MAVLink(None, srcSystem=7, srcComponent=1)
    heartbeat = mav.heartbeat_encode(
        common.MAV_TYPE_QUADROTOR, common.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 0
    )
    foreign = bytes(heartbeat.pack(mav))
    wires = Wires()
    wires.outgoing = lambda frame: (foreign, frame)
    report = FactReport(matching(facts_of("1.16", FACTS).values(), ["mode.offboard-disarmed"]))

    client = check(wires.companion(), None, report, Terms(), lambda _: None)

    assert client.system_id == 1
