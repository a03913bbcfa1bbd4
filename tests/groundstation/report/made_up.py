"""Made-up flight folders for reports, and the reverse of what a report packs."""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from groundstation.recording.writer import RecordFiles
from groundstation.report.columns import Column, unpacked
from onboard.arrays import Array
from onboard.bus.schema import Event, Message, MocapPose, Order, OrderReply, Truth
from onboard.bus.topics import Topic
from tests.groundstation.console.fake import telemetry
from tests.groundstation.recorded import FLEET, LEVEL, SECOND, ZERO, tick

BEGIN_NS = 5 * SECOND
Row = tuple[int, Topic, str, Message]

# of two vehicles that meet head on
SPEED_M_S = 1.0
APART_M = 2.0
BEFORE_M_S2 = 3.0  # thrust before the law, towards the other one


def position(vehicle: int, time_s: float) -> tuple[float, float, float]:
    """Two vehicles that pass each other: mav0 eastwards, mav1 stands 0.9 m beside its way."""
    height_m = max(0.0, min(1.0, time_s, 9.0 - time_s))
    if vehicle == 0:
        return (0.5 * (time_s - 5.0), 0.0, height_m)
    return (0.0, 0.9, height_m)


def rows(
    names: tuple[str, ...] = ("mav0", "mav1"),
    *,
    length_s: float = 10.0,
    has_truth: bool = True,
    ground_m: float = 0.0,
) -> list[Row]:
    """The messages of ten seconds: ticks and truth 50 times a second, telemetry 10 times."""
    told: list[Row] = []
    for step in range(round(50 * length_s)):
        at_ns = BEGIN_NS + step * SECOND // 50
        for index, name in enumerate(names):
            x, y, height_m = position(index, step / 50)
            place = (x, y, ground_m + height_m)
            own_tick = msgspec.structs.replace(
                tick(at_ns),
                position_enu_m=place,
                setpoint_position_enu_m=place,
                active_neighbour=names[1 - index],
                neighbour_ages_s={names[1 - index]: 0.02 + 0.001 * (step % 5)},
            )
            told.append((at_ns, Topic.TICK, name, own_tick))
            if has_truth:
                truth = Truth(
                    vehicle=name,
                    stamp_ns=at_ns,
                    position_enu_m=place,
                    velocity_enu_m_s=ZERO,
                    quaternion_enu_flu_wxyz=LEVEL,
                    is_on_ground=height_m <= 0.0,
                    is_collided=False,
                )
                told.append((at_ns, Topic.TRUTH, name, truth))
            if step % 5 == 0:
                told.append((at_ns, Topic.TELEMETRY, name, said(name, at_ns, step, place)))
    return told


def ahead(told: list[Row], vehicle: str, ahead_ns: int) -> list[Row]:
    """The same messages, those of a vehicle stamped by a clock of its own that is ahead."""
    changed: list[Row] = []
    for at_ns, topic, name, message in told:
        if name == vehicle and topic in (Topic.TICK, Topic.TELEMETRY):
            own: Any = message
            message = msgspec.structs.replace(own, stamp_ns=own.stamp_ns + ahead_ns)
        changed.append((at_ns, topic, name, message))
    return changed


def said(name: str, at_ns: int, step: int, place: tuple[float, float, float]) -> Message:
    battery_frac = math.nan if step == 0 else 0.9 - 0.0001 * step
    return telemetry(
        name,
        stamp_ns=at_ns,
        sequence=step + 1,
        position_enu_m=place,
        velocity_enu_m_s=ZERO,
        battery_frac=battery_frac,
    )


def head_on(law: str = "covey") -> list[Row]:
    """mav0 from the west and mav1 from the east, at the same moment again and again."""
    told: list[Row] = []
    for step in range(20):
        at_ns = BEGIN_NS + step * SECOND // 50
        for name, other, side in (("mav0", "mav1", -1.0), ("mav1", "mav0", 1.0)):
            place = (side * APART_M / 2.0, 0.0, 1.0)
            velocity = (-side * SPEED_M_S, 0.0, 0.0)
            own_tick = msgspec.structs.replace(
                tick(at_ns),
                position_enu_m=place,
                velocity_enu_m_s=velocity,
                predicted_position_enu_m=place,
                predicted_velocity_enu_m_s=velocity,
                thrust_baseline_enu_m_s2=(-side * BEFORE_M_S2, 0.0, 9.81),
                active_neighbour=other,
                neighbour_ages_s={other: 0.0},
            )
            told.append((at_ns, Topic.TICK, name, own_tick))
            said = telemetry(
                name,
                stamp_ns=at_ns,
                sequence=step + 1,
                position_enu_m=place,
                velocity_enu_m_s=ZERO,
                law=law,
            )
            told.append((at_ns, Topic.TELEMETRY, name, said))
    return told


def story(vehicle: str, author: str = "anna", sentence: str = "At 1.00 m.") -> list[Row]:
    """An order, its answer and its end."""
    order = Order(
        order_id="ground-1-1",
        author=author,
        kind="takeoff",
        stamp_ns=BEGIN_NS + SECOND,
        deadline_ns=BEGIN_NS + 2 * SECOND,
        node="ground-1",
    )
    reply = OrderReply(order_id="ground-1-1", vehicle=vehicle, is_accepted=True, reason="")
    event = Event(
        vehicle=vehicle,
        stamp_ns=BEGIN_NS + 3 * SECOND,
        severity="warning",
        code="order-takeoff",
        sentence=sentence,
        order_id="ground-1-1",
        order_outcome="done",
    )
    return [
        (BEGIN_NS + SECOND, Topic.ORDER, vehicle, order),
        (BEGIN_NS + SECOND + 1, Topic.ORDER, vehicle, reply),
        (BEGIN_NS + 3 * SECOND, Topic.EVENT, vehicle, event),
    ]


def poses(
    body: str,
    place_at: Callable[[float], tuple[float, float, float]],
    begin_s: float,
    end_s: float,
    *,
    is_tracked: bool = True,
) -> list[Row]:
    """The motion capture's messages about a body, 50 times a second."""
    told: list[Row] = []
    for step in range(round(50 * begin_s), round(50 * end_s)):
        at_ns = BEGIN_NS + step * SECOND // 50
        pose = MocapPose(
            body=body,
            boot_id=1,
            sequence=step + 1,
            stamp_ns=at_ns,
            is_tracked=is_tracked,
            position_enu_m=place_at(step / 50),
            quaternion_enu_flu_wxyz=LEVEL,
        )
        told.append((at_ns, Topic.MOCAP, body, pose))
    return told


def write(folder: Path, told: list[Row], *, fleet: str | None = None) -> Path:
    """A flight folder, as the recorder leaves it."""
    folder.mkdir(parents=True, exist_ok=True)
    text = FLEET.read_text(encoding="utf-8") if fleet is None else fleet
    if text:
        (folder / "fleet.toml").write_text(text, encoding="utf-8")

    stream = (folder / "flight.mcap").open("wb")
    files = RecordFiles(folder, stream, begin_ns=BEGIN_NS, begin="a test")
    flushed_ns = 0
    for at_ns, topic, name, message in sorted(told, key=lambda row: row[0]):
        files.write(topic, name, message, at_ns)
        if at_ns - flushed_ns >= SECOND:
            files.flush()
            flushed_ns = at_ns
    files.finish()
    files.close()
    return folder


def opened(data: bytes) -> tuple[dict[str, Any], dict[str, Array]]:
    """The header and the curves of a payload."""
    content = zlib.decompress(data)
    (length,) = struct.unpack_from("<I", content)
    header = json.loads(content[4 : 4 + length])

    curves = {}
    size = 2 * header["count"]
    begin = 4 + length
    for key, scale, offset in header["columns"]:
        column = Column(key, scale=scale, offset=offset, data=content[begin : begin + size])
        curves[key] = unpacked(column)
        begin += size
    assert begin == len(content)
    return header, curves
