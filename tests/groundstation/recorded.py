"""Made-up records for tests: three vehicles, mav0 flies past the others."""

from __future__ import annotations

import contextlib
import math
import shutil
from collections.abc import Collection
from pathlib import Path

from groundstation.recording.reader import Sample
from groundstation.recording.timeline import Timeline
from groundstation.recording.writer import RecordFiles
from onboard.bus.schema import Event, Message, TickSample, Truth
from onboard.bus.topics import Topic
from tests.groundstation.console.fake import telemetry

FLEET = Path(__file__).parents[2] / "configs" / "fleets" / "paper.toml"
SECOND = 1_000_000_000
ZERO = (0.0, 0.0, 0.0)
LEVEL = (1.0, 0.0, 0.0, 0.0)


def spot(vehicle: int, time_s: float) -> tuple[float, float, float]:
    """Where a vehicle of the made-up flight is: mav0 flies past the others, closest at 20 s."""
    return (0.1 * (time_s - 20.0) if vehicle == 0 else 0.0, (0.0, 1.0, 2.2)[vehicle], 1.0)


def messages(length_s: float, clock_ns: dict[str, int]) -> list[tuple[int, Topic, str, Message]]:
    """What a recorder would hear: (when, topic, name, message)."""
    told: list[tuple[int, Topic, str, Message]] = []
    for step in range(int(length_s * 10)):
        at_ns = 5 * SECOND + step * SECOND // 10
        for index, name in enumerate(("mav0", "mav1", "mav2")):
            place = spot(index, step / 10)
            stamp_ns = at_ns + clock_ns.get(name, 0)
            told.append((at_ns, Topic.TELEMETRY, name, telemetry(
                name, stamp_ns=stamp_ns, sequence=step + 1, position_enu_m=place,
                velocity_enu_m_s=ZERO,
                battery_frac=math.nan if step == 3 else 0.9)))  # fmt: skip
            told.append((at_ns, Topic.TRUTH, name, Truth(
                vehicle=name, stamp_ns=at_ns, position_enu_m=place, velocity_enu_m_s=ZERO,
                quaternion_enu_flu_wxyz=LEVEL, is_on_ground=False, is_collided=False)))  # fmt: skip
            if step % 50 == 0:
                told.append((at_ns, Topic.EVENT, name, Event(
                    vehicle=name, stamp_ns=stamp_ns + index, severity="info", code="x",
                    sentence=f"{name} at {step // 10} s")))  # fmt: skip
    return told


def record(
    folder: Path,
    length_s: float = 40.0,
    clock_ns: dict[str, int] | None = None,
    *,
    flush_s: float = 1.0,
) -> Path:
    """A flight folder as the recorder leaves it."""
    folder.mkdir(parents=True)
    shutil.copy(FLEET, folder / "fleet.toml")
    files = RecordFiles(
        folder, (folder / "flight.mcap").open("wb"), begin_ns=5 * SECOND, begin="a test"
    )
    flushed_ns = 0
    for at_ns, topic, name, message in messages(length_s, clock_ns or {}):
        files.write(topic, name, message, at_ns)
        if at_ns - flushed_ns >= flush_s * SECOND:
            files.flush()
            flushed_ns = at_ns
    files.finish()
    files.close()
    return folder


def read(folder: Path, topics: Collection[str] = ()) -> list[Sample]:
    """The samples of some topics of a record; of all topics if none is named."""
    with contextlib.closing(Timeline(folder)) as timeline:
        return list(timeline.samples(topics or timeline.topics))


def tick(stamp_ns: int) -> TickSample:
    return TickSample(
        stamp_ns=stamp_ns, period_s=0.02, state="flying", position_enu_m=ZERO,
        velocity_enu_m_s=ZERO,
        acceleration_enu_m_s2=ZERO, yaw_rad=0.0, setpoint_position_enu_m=ZERO,
        setpoint_velocity_enu_m_s=ZERO,
        setpoint_acceleration_enu_m_s2=ZERO, thrust_baseline_enu_m_s2=(0.0, 0.0, 9.81),
        thrust_safe_enu_m_s2=(0.0, 1.0, 9.81), predicted_position_enu_m=ZERO,
        predicted_velocity_enu_m_s=ZERO,
        commanded_acceleration_enu_m_s2=ZERO, law_status="saturated", intervention_m_s2=1.0,
        slack_m_s2=0.0,
        active_neighbour="mav1", neighbour_distances_m={"mav1": 1.1},
        neighbour_ages_s={"mav1": 0.02},
        setpoint_quaternion_enu_flu_wxyz=LEVEL, setpoint_thrust_frac=0.7,
        attitude_quaternion_enu_flu_wxyz=LEVEL,
        hover_thrust_frac=0.7,
    )  # fmt: skip
