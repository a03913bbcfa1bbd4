"""Is what we are told about ourselves and the others still true? Freshness, jumps, frozen and swapped bodies.

Pure and clockless: the caller says what time it is, in nanoseconds of its own monotonic clock.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from onboard.types import Array, BoolArray, IntArray

_Scalar = TypeVar("_Scalar", bound=np.generic)


class Freshness(IntEnum):
    """Answer to "may I still use it"."""

    FRESH = 0
    LATE = 1  # older than usual: worth a word, still usable
    STALE = 2  # too old to act on
    MISSING = 3  # never seen


def age_s(now_ns: int, stamp_ns: int | None) -> float:
    """Seconds since a stamp, infinite when there is none; a stamp from the future counts as fresh as now."""
    return float("inf") if stamp_ns is None else max(0, now_ns - stamp_ns) / 1e9


def freshness(now_ns: int, stamp_ns: int | None, *, late_after_s: float, stale_after_s: float) -> Freshness:
    """Classify by age; the bounds are inclusive."""
    if stamp_ns is None:
        return Freshness.MISSING
    age = age_s(now_ns, stamp_ns)
    return Freshness.FRESH if age <= late_after_s else Freshness.LATE if age <= stale_after_s else Freshness.STALE


@dataclass(frozen=True, slots=True)
class MocapParams:
    """Bounds of a believable body.

    max_speed_m_s, max_acceleration_m_s2: what a vehicle can do, with reserve. noise_m: of a sample. frozen_after_s: so
    long may bit-identical samples come before the body counts as frozen (a tracked body always has noise).
    swap_radius_m: a jump that lands this near to where another body was expected is a swap.
    """

    max_speed_m_s: float = 4.0
    max_acceleration_m_s2: float = 15.0
    noise_m: float = 0.01
    frozen_after_s: float = 0.1
    swap_radius_m: float = 0.15


class MocapFault(IntEnum):
    """What is wrong with a body's newest sample."""

    NONE = 0
    INVALID = 1  # not finite, or its stamp does not advance
    JUMPED = 2  # farther than the vehicle can have moved
    SWAPPED = 3  # jumped to where another body was expected
    FROZEN = 4  # the same numbers again and again


@dataclass(frozen=True, slots=True)
class MocapMemory:
    """The last believed samples of B bodies: position, velocity (B, 3), stamp_ns (B,), first stamp of equal samples.

    last_sample_enu_m (B, 3) is what came last, believed or not.
    """

    position_enu_m: Array
    velocity_enu_m_s: Array
    stamp_ns: IntArray
    last_sample_enu_m: Array
    same_since_ns: IntArray
    is_known: BoolArray


def initial(bodies: int) -> MocapMemory:
    """Nothing seen of any of ``bodies``."""
    nothing = np.zeros((bodies, 3))
    never = np.zeros(bodies, dtype=np.int64)
    return MocapMemory(nothing, nothing, never, np.full((bodies, 3), np.nan), never, np.zeros(bodies, dtype=np.bool_))


def watch(
    memory: MocapMemory, body: int, position_enu_m: Array, stamp_ns: int, *, params: MocapParams
) -> tuple[MocapMemory, MocapFault]:
    """Judge one sample of one body; a faulty one is not believed and does not move the expectation.

    The reach of a body grows with the time since its last believed sample: v t bounded by the top speed plus what it
    can accelerate. A body that really is elsewhere after a gap is thus believed again.

    Args:
        position_enu_m: (3,). stamp_ns: when it was taken.
    """
    sample = np.asarray(position_enu_m, dtype=np.float64)
    if not np.isfinite(sample).all() or (memory.is_known[body] and stamp_ns <= memory.stamp_ns[body]):
        return memory, MocapFault.INVALID
    same = bool(np.array_equal(sample, memory.last_sample_enu_m[body]))
    same_since = int(memory.same_since_ns[body]) if same else stamp_ns
    memory = replace(
        memory,
        last_sample_enu_m=_with(memory.last_sample_enu_m, body, sample),
        same_since_ns=_with(memory.same_since_ns, body, same_since),
    )
    if (stamp_ns - same_since) * 1e-9 >= params.frozen_after_s:
        return memory, MocapFault.FROZEN
    if memory.is_known[body]:
        gap_s = (stamp_ns - int(memory.stamp_ns[body])) * 1e-9
        expected = memory.position_enu_m[body] + gap_s * memory.velocity_enu_m_s[body]
        reach = 4.0 * params.noise_m + min(0.5 * params.max_acceleration_m_s2 * gap_s, params.max_speed_m_s) * gap_s
        if float(np.sqrt(np.square(sample - expected).sum())) > reach + 2.0 * params.noise_m:
            return memory, _kind_of_jump(memory, body, sample, stamp_ns, params)
        velocity = memory.velocity_enu_m_s[body]
        velocity = velocity + 0.3 * ((sample - memory.position_enu_m[body]) / gap_s - velocity)
        speed = float(np.sqrt(np.square(velocity).sum()))
        velocity = velocity * min(1.0, params.max_speed_m_s / max(speed, 1e-9))
    else:
        velocity = np.zeros(3)
    memory = replace(
        memory,
        position_enu_m=_with(memory.position_enu_m, body, sample),
        velocity_enu_m_s=_with(memory.velocity_enu_m_s, body, velocity),
        stamp_ns=_with(memory.stamp_ns, body, stamp_ns),
        is_known=_with(memory.is_known, body, True),
    )
    return memory, MocapFault.NONE


def _kind_of_jump(memory: MocapMemory, body: int, sample: Array, stamp_ns: int, params: MocapParams) -> MocapFault:
    gaps_s = np.maximum((stamp_ns - memory.stamp_ns) * 1e-9, 0.0)
    # a body that swapped, too, has no fresh expectation: extrapolate the last believed one, but not for ever
    expected = memory.position_enu_m + np.minimum(gaps_s, 0.3)[:, None] * memory.velocity_enu_m_s
    near = np.sqrt(np.square(expected - sample).sum(axis=-1)) <= params.swap_radius_m
    near &= memory.is_known
    near[body] = False
    return MocapFault.SWAPPED if near.any() else MocapFault.JUMPED


def _with(values: NDArray[_Scalar], index: int, value: Array | float) -> NDArray[_Scalar]:
    out = values.copy()
    out[index] = value
    return out
