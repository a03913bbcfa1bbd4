"""Corrections in an agent: given to PX4, told, and what a flight does when they end."""

from __future__ import annotations

import math
import subprocess
import sys

import msgspec
import pytest

from onboard import agent_commands, agent_inputs
from onboard.agent.core import AgentCore
from onboard.bus.schema import Corrections
from onboard.config.fleet import CorrectionsConfig
from onboard.px4.message_parsers import PARSERS
from tests.onboard.agent.rig import Rig, fleet
from tests.onboard.corrections.rtcm_frames import STATION, ZURICH_DEG, base_frame, epoch

FIXED = 6
FLOAT = 5
PLAIN = 3


class CorrectedRig(Rig):
    """A rig whose vehicle flies by satellites, with a base that sends once a second."""

    base_east_m = 0.0
    is_base_silent = False

    def tell(self, fix_type: int, accuracy_m: float) -> None:
        self.snapshot = msgspec.structs.replace(
            self.snapshot, fix_type=fix_type, satellites=17, fix_accuracy_m=accuracy_m
        )

    def step(self) -> None:
        if self.tick_count % 50 == 0 and not self.is_base_silent:
            second = self.tick_count // 50
            self.send(base_frame(east_m=self.base_east_m), *epoch(second))
        super().step()

    def send(self, *frames: bytes) -> None:
        for sequence, frame in enumerate(frames):
            message = Corrections(
                source="corrections",
                boot_id=1,
                sequence=sequence,
                stamp_ns=self.now_ns,
                frame=frame,
            )
            received = agent_inputs.CorrectionsReceived(message, self.now_ns)
            self.core.handle(received, self.now_ns)

    @property
    def fragments(self) -> list[agent_commands.SendCorrections]:
        return [
            command
            for _, command in self.sent
            if isinstance(command, agent_commands.SendCorrections)
        ]


def rig_of(fix: str = "rtk_fixed", **table) -> CorrectedRig:
    whole = fleet(("mav0",))
    bare = {n: msgspec.structs.replace(v, mocap_required=False) for n, v in whole.vehicles.items()}
    corrections = msgspec.convert({"source": "mock", "fix": fix, **table}, CorrectionsConfig)
    whole = msgspec.structs.replace(whole, vehicles=bare, corrections=corrections)
    rig = CorrectedRig(AgentCore(whole, "mav0", boot_id=7), has_mocap=False)
    rig.snapshot = msgspec.structs.replace(
        rig.snapshot, position_accuracy_m=0.3, global_origin=(*ZURICH_DEG, 490.0)
    )
    rig.tell(FIXED, 0.014)
    return rig


def codes(rig: Rig) -> set[str]:
    return {event.code for event in rig.events}


def test_each_frame_leaves_in_fragments_behind_the_setpoint_of_its_tick():
    rig = rig_of()
    rig.fly()
    rig.sent.clear()
    rig.run(1.0)

    frames = [base_frame(), *epoch(rig.tick_count // 50)]
    given = b"".join(fragment.data for fragment in rig.fragments)
    assert given == b"".join(frames)
    assert len({fragment.flags >> 3 for fragment in rig.fragments}) == len(frames)

    kinds = [type(command) for _, command in rig.sent]
    for index, kind in enumerate(kinds):
        if kind is agent_commands.SendCorrections:
            earlier = [time for time, command in rig.sent[:index]]
            time = rig.sent[index][0]
            same_tick = [kinds[number] for number, then in enumerate(earlier) if then == time]
            assert agent_commands.SendAttitude in same_tick


def test_telemetry_has_fix_satellites_age_base_and_distance():
    rig = rig_of()
    rig.run(2.5)
    assert rig.telemetry is not None
    assert (rig.telemetry.fix, rig.telemetry.satellites) == ("RTK fixed", 17)
    assert 0.0 < rig.telemetry.corrections_age_s < 1.2
    assert rig.telemetry.base_id == STATION
    assert rig.telemetry.base_distance_m == pytest.approx(0.0, abs=0.01)


def test_a_vehicle_without_corrections_tells_its_fix_and_no_more():
    rig = rig_of()
    whole = msgspec.structs.replace(rig.core.fleet, corrections=None)
    bare = Rig(AgentCore(whole, "mav0", boot_id=7), has_mocap=False, snapshot=rig.snapshot)
    bare.run(1.0)
    assert bare.telemetry is not None
    assert bare.telemetry.fix == "RTK fixed"
    assert math.isnan(bare.telemetry.corrections_age_s)
    assert bare.telemetry.base_id == -1


@pytest.mark.realtime
def test_an_agent_of_a_fleet_without_corrections_imports_nothing_of_them():
    program = (
        "import sys\n"
        "from onboard.agent.core import AgentCore\n"
        "from onboard.config.fleet import load_fleet\n"
        "AgentCore(load_fleet('configs/fleets/px4-sitl.toml'), 'mav0', boot_id=1)\n"
        "names = ('intake', 'base_watch', 'rtcm', 'fragments', 'relay')\n"
        "print([n for n in names if f'onboard.corrections.{n}' in sys.modules])\n"
        "print('pyrtcm' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.split("\n")[:2] == ["[]", "False"], done.stderr


@pytest.mark.failsafe("satellite fix fell back", step="on the ground, disarmed")
@pytest.mark.parametrize("fix_type", [3, 5, 77])
def test_a_fix_below_the_demanded_one_refuses_the_take_off(fix_type: int):
    rig = rig_of()
    rig.tell(fix_type, 0.014)
    rig.run(4.0)
    assert rig.core.flight.state == "waiting"
    assert any("this fleet demands RTK fixed" in one for one in rig.core.preflight.not_ready)
    assert not rig.order("takeoff", height_m=1.0).is_accepted


def test_nobody_is_ready_in_the_moment_before_the_failsafes_have_seen_the_new_fix():
    rig = rig_of()
    rig.tell(FLOAT, 0.4)
    rig.run(3.0)
    rig.tell(FIXED, 0.014)
    while rig.core.flight.state == "waiting":
        rig.step()
    assert not rig.core.failsafes.conditions


@pytest.mark.failsafe("satellite fix fell back", step="flying")
def test_a_fix_that_falls_back_in_flight_slows_it_and_widens_what_the_others_keep():
    rig = rig_of()
    rig.fly()
    assert rig.state is not None
    before_m = rig.state.position_std_m
    rig.tell(FLOAT, 0.4)
    rig.run(0.4)
    rig.tell(FIXED, 0.014)
    rig.run(1.0)
    assert "fix-fell-back" not in codes(rig)  # a moment is none

    rig.tell(FLOAT, 0.4)
    rig.run(1.0)
    assert "fix-fell-back" in codes(rig)
    assert rig.core.flight.state == "flying"
    assert rig.telemetry is not None
    assert rig.telemetry.action == "flying slowly"
    assert rig.state.position_std_m == pytest.approx(0.4 * math.sqrt(0.5), rel=0.05)
    assert rig.state.position_std_m > before_m

    rig.tell(FIXED, 0.014)
    rig.run(1.0)
    assert rig.state.position_std_m == pytest.approx(before_m, rel=0.05)


@pytest.mark.failsafe("satellite fix fell back, position coarse", step="flying")
def test_a_fix_that_falls_back_further_than_the_fleet_bears_holds_it():
    rig = rig_of(hold_accuracy_m=0.5)
    rig.fly()
    rig.tell(PLAIN, 0.9)
    rig.run(1.0)
    assert rig.core.flight.state == "holding"
    assert "fix-coarse" in codes(rig)


def test_a_fleet_that_demands_no_fix_flies_on_without_one():
    rig = rig_of(fix="any")
    rig.fly()
    rig.tell(PLAIN, 0.9)
    rig.run(2.0)
    assert rig.core.flight.state == "flying"
    assert not codes(rig) & {"fix-fell-back", "fix-coarse"}


@pytest.mark.failsafe("base of the corrections not believed", step="on the ground, disarmed")
def test_a_base_elsewhere_than_surveyed_refuses_the_take_off():
    rig = rig_of(base_deg=list(ZURICH_DEG))
    rig.base_east_m = 30.0
    rig.run(4.0)
    reasons = rig.core.preflight.not_ready
    assert any("is not where it was surveyed, by 29.9 m" in one for one in reasons)
    assert rig.fragments == []


@pytest.mark.failsafe("base of the corrections not believed", step="flying")
def test_a_base_that_jumps_in_flight_is_told_and_its_corrections_are_not_given_to_px4():
    rig = rig_of()
    rig.fly()
    rig.base_east_m = 30.0
    rig.run(1.5)
    rig.sent.clear()
    rig.run(3.0)
    assert rig.core.flight.state == "flying"
    assert "base-fault" in codes(rig)
    assert rig.fragments == []


@pytest.mark.failsafe("corrections old", step="flying")
def test_corrections_that_stay_away_are_told_before_the_fix_falls_back():
    rig = rig_of(max_age_s=3.0)
    rig.fly()
    rig.is_base_silent = True
    rig.run(2.5)
    assert "corrections-old" not in codes(rig)
    rig.run(2.0)
    assert "corrections-old" in codes(rig)
    assert rig.core.flight.state == "flying"


def test_what_px4_was_not_given_is_counted_in_telemetry():
    rig = rig_of()
    rig.run(1.0)
    assert rig.telemetry is not None
    before = rig.telemetry.malformed_messages
    rig.send(b"garbage", b"", 300 * b"\xd3")
    rig.run(0.3)
    assert rig.telemetry.malformed_messages == before + 3


def test_a_receiver_is_read_with_satellites_and_accuracy():
    fields = {"fix_type": 6, "satellites_visible": 21, "h_acc": 14}
    taken = PARSERS["GPS_RAW_INT"](fields, 5)
    assert taken["fix_type"] == 6
    assert taken["has_fix"]
    assert taken["satellites"] == 21
    assert taken["fix_accuracy_m"] == pytest.approx(0.014)
    unknown = PARSERS["GPS_RAW_INT"]({**fields, "satellites_visible": 255, "h_acc": 0}, 5)
    assert unknown["satellites"] == -1
    assert unknown["fix_accuracy_m"] == 0.0
