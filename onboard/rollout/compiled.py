"""Numba, when there is any use for it: the kernels compiled for batches, and the rule who runs what.

One vehicle is computed by the interpreted kernels: a drone's process never loads numba (130 MiB and a second of
imports) and has nothing to compile in flight. Batches use the compiled kernels, or the array forms where numba is
missing or ``COVEY_NUMBA=0``. Without fused or reordered arithmetic both ways give the same bits.

Compiled code is kept on disk by numba beside the source, or in the user's cache folder where that is read-only; where
neither can be written, each process compiles anew. ``warm_up`` does it at a moment of the caller's choice.
"""

from __future__ import annotations

import marshal
import os
import zlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from types import FunctionType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from onboard.avoidance import kernel_projection, kernels
from onboard.avoidance.params import LawNumbers, LawParams
from onboard.control import kernel_motion, kernel_pass
from onboard.types import Array, BoolArray

_T = TypeVar("_T", bound=np.generic)
ENVIRONMENT = "COVEY_NUMBA"
Kernel = Callable[..., Any]


def is_wanted() -> bool:
    """Whether compiled kernels may be used at all."""
    return os.environ.get(ENVIRONMENT, "") != "0"


def uses_kernel(size: int) -> bool:
    """Whether a batch of ``size`` vehicles is for the kernels rather than for the array forms."""
    return size == 1 or (size > 0 and is_wanted() and numba() is not None)


def is_compiled(size: int) -> bool:
    """Whether a kernel is run compiled for this size, and not interpreted."""
    return size > 1


@lru_cache(maxsize=1)
def numba() -> Any:
    """The module, or None."""
    try:
        import numba as module
        from numba import extending
    except ImportError:
        return None
    for function in _functions():
        extending.register_jitable(function)
    return module


_MODULES = (kernel_projection, kernels, kernel_motion, kernel_pass)


def _functions() -> list[FunctionType]:
    return [f for m in _MODULES for f in vars(m).values() if isinstance(f, FunctionType) and f.__module__ == m.__name__]


@lru_cache(maxsize=1)
def _digest() -> int:
    """Changes with any kernel: numba's own check sees only the file of the function that it is told to compile."""
    constants = [item for m in _MODULES for item in sorted(vars(m).items()) if isinstance(item[1], (int, float))]
    code = b"".join(marshal.dumps(f.__code__) for f in _functions())
    return zlib.crc32(code + repr((LawNumbers._fields, constants)).encode())


def _jit(function: Kernel, error_model: str = "python") -> Kernel:
    """The function compiled on first use, from numba's cache where there is one."""
    module, how = numba(), {"nogil": True, "fastmath": False, "error_model": error_model}
    try:
        return module.njit(cache=True, **how)(function)  # type: ignore[no-any-return]
    except RuntimeError:  # no folder to keep the code in
        return module.njit(**how)(function)  # type: ignore[no-any-return]


@lru_cache(maxsize=1)
def _covey_batch() -> Kernel:
    version, covey = _digest(), kernels.covey

    def run(
        floats: Any,
        vectors: Any,
        scalars: Any,
        masks: Any,
        capsules: Any,
        n: Any,
        sizes: Any,
        out: Any,
    ) -> int:
        position, velocity, predicted_position, predicted_velocity, command, intent = vectors
        age, lead, std_p, std_v, crowd = scalars
        is_present, is_cooperative = masks
        a, r = sizes
        e_x, e_y, w_x, w_y, h_x, h_y = np.zeros(a), np.zeros(a), np.zeros(a), np.zeros(a), np.zeros(a), np.zeros(a)
        c_x, c_y, gap, reach, full = np.zeros(a), np.zeros(a), np.zeros(a), np.zeros(a), np.zeros(a)
        n_x, n_y, b, m_x, m_y, m_b = np.zeros(r), np.zeros(r), np.zeros(r), np.zeros(r), np.zeros(r), np.zeros(r)
        rank, chosen = np.zeros(a, np.int64), np.zeros(r, np.int64)
        for m in range(floats.shape[0]):
            f = floats[m]
            x, y, status, slack, count, active = covey(
                (f[0], f[1]), (f[2], f[3]), f[4], (f[5], f[6], f[7], f[8], f[9], f[10], f[11], f[12], f[13]),
                position[m], velocity[m], predicted_position[m], predicted_velocity[m], command[m], intent[m],
                (age[m], lead[m], std_p[m], std_v[m], crowd[m]), is_present[m], is_cooperative[m], capsules, n,
                (e_x, e_y, w_x, w_y, h_x, h_y, c_x, c_y, gap, reach, full, n_x, n_y, b, m_x, m_y, m_b), (rank, chosen),
            )  # fmt: skip
            out[m, 0], out[m, 1], out[m, 2], out[m, 3], out[m, 4], out[m, 5] = x, y, status, slack, count, active
        return version

    return _jit(run)


def covey_one(
    floats: Sequence[float], vectors: Sequence[Any], scalars: Sequence[Any], masks: Sequence[Any], params: LawParams
) -> Array:
    """``kernels.covey`` interpreted, (6,); arguments as in :func:`covey_batch` without M, as lists."""
    a, r = kernels.work_sizes(len(scalars[0]), len(params.capsules_enu_m))
    w_x, w_y, s_x, s_y, radius, p_x, p_y, v_x, v_y, i_x, i_y, std_p, std_v, floor = floats
    position, velocity, predicted_position, predicted_velocity, command, intent = vectors
    age, lead, their_std_p, their_std_v, crowd = scalars
    is_present, is_cooperative = masks
    work = tuple([[0.0] * a for _ in range(11)] + [[0.0] * r for _ in range(6)])
    result = kernels.covey(
        (w_x, w_y), (s_x, s_y), radius, (p_x, p_y, v_x, v_y, i_x, i_y, std_p, std_v, floor),
        position, velocity, predicted_position, predicted_velocity, command, intent,
        (age, lead, their_std_p, their_std_v, crowd), is_present, is_cooperative, params.capsule_values,
        params.numbers, work, ([0] * a, [0] * r),
    )  # fmt: skip
    return np.array(result)


def covey_batch(
    floats: Array, vectors: Sequence[Array], scalars: Sequence[Array], masks: Sequence[BoolArray], params: LawParams
) -> Array:
    """``kernels.covey`` compiled, for M vehicles, (M, 6).

    Args:
        floats: (M, 14) wanted, shift (2 each), radius, position, velocity, intent (2 each), two standard
            deviations, least crowd count.
        vectors: six of (M, 3 K). scalars: five of (M, K). masks: two of (M, K). See ``kernels.covey``.
    """
    sizes = kernels.work_sizes(scalars[0].shape[1], len(params.capsules_enu_m))
    capsules = np.array(params.capsule_values, dtype=np.float64)
    out = np.empty((len(floats), 6))
    _covey_batch()(floats, tuple(vectors), tuple(scalars), tuple(masks), capsules, params.numbers, sizes, out)
    return out


@lru_cache(maxsize=1)
def _predicted_batch() -> Kernel:
    version, predicted = _digest(), kernel_motion.predicted

    def run(commands: Any, durations: Any, position: Any, velocity: Any, windows: Any, rest_z: float, out: Any) -> int:
        for m in range(position.shape[0]):
            p, v = predicted(commands[m], durations[m], position[m], velocity[m], windows[m, 0], windows[m, 1], rest_z)
            out[m, 0], out[m, 1], out[m, 2] = p
            out[m, 3], out[m, 4], out[m, 5] = v
        return version

    return _jit(run)


def predicted_batch(
    commands: Array, durations: Array, position: Array, velocity: Array, windows: Array, rest_z: float
) -> Array:
    """``kernel_motion.predicted`` compiled, for M vehicles: position and velocity (M, 6).

    Args:
        commands: (M, 3 B). durations: (M, B). position, velocity: (M, 3). windows: (M, 2), the horizontal one and z's.
    """
    out = np.empty((len(position), 6))
    _predicted_batch()(commands, durations, position, velocity, windows, rest_z, out)
    return out


@lru_cache(maxsize=1)
def _moved_back_batch() -> Kernel:
    def run(remembered: Any, ages: Any, change: Any, out: Any) -> None:
        for m in range(remembered.shape[0]):
            for k in range(remembered.shape[1]):
                age = ages[k]
                for c in range(3):
                    moved = remembered[m, k, c] + change[m, 0, c] - age * change[m, 1, c]
                    out[m, k, c] = moved + 0.5 * age * age * change[m, 2, c]

    return _jit(run)


def moved_back_batch(remembered: Array, ages: Array, change: Array) -> Array:
    """Remembered positions (M, N, 3) of ``ages`` (N,) with a change (M, 3, 3) of position, velocity, acceleration."""
    out = np.empty_like(remembered)
    _moved_back_batch()(remembered, ages, change, out)
    return out


@lru_cache(maxsize=1)
def _around_batch() -> tuple[Kernel, Kernel]:
    version, before, after = _digest(), kernel_pass.before, kernel_pass.after

    def run_before(
        vectors: Any, leg: Any, scalars: Any, commands: Any, history: Any, held: Any, n: Any, out: Any, out_1: Any,
        out_commands: Any, floats: Any,
    ) -> tuple[int, int]:  # fmt: skip
        is_sound = before(vectors, leg, scalars, commands, history, held, n, out, out_1, out_commands, floats)
        return is_sound, version

    def run_after(
        result: Any, floats: Any, given: Any, hover: Any, scalars: Any, history: Any, held: Any, n: Any, out: Any,
        out_4: Any, out_1: Any, out_history: Any, out_held: Any,
    ) -> int:  # fmt: skip
        after(result, floats, given, hover, scalars, history, held, n, out, out_4, out_1, out_history, out_held)
        return version

    # division by zero gives what is not finite, which ``before`` looks for
    return _jit(run_before, "numpy"), _jit(run_after, "numpy")


def before_batch(*arguments: Any) -> bool:
    """``kernel_pass.before`` compiled; whether the input was sound."""
    return bool(_around_batch()[0](*arguments)[0])


def after_batch(*arguments: Any) -> None:
    """``kernel_pass.after`` compiled."""
    _around_batch()[1](*arguments)


def flat(array: NDArray[_T], size: int, *inner: int) -> NDArray[_T]:
    """An array of any leading shape as one contiguous (size, *inner) that compiled code takes."""
    is_flat = array.ndim == 1 + len(inner) and array.shape[0] == size
    shaped = array if is_flat else array.reshape(size, *inner)
    return shaped if shaped.flags.carray else np.require(shaped, requirements=["C", "W"])


def warm_up() -> bool:
    """Compile, or load from numba's cache, all that batches use; False when nothing is to be compiled.

    Takes about a second from the cache, and some fifteen seconds of a processor the first time on a machine.
    """
    if not is_wanted() or numba() is None:
        return False
    two = np.zeros((2, 3))
    scalar = np.zeros((2, 1))
    floats = np.zeros((2, 14))
    covey_batch(floats, [two] * 6, [scalar] * 5, [scalar > 1.0] * 2, LawParams())
    predicted_batch(two, scalar, two, two, np.zeros((2, 2)), 0.0)
    moved_back_batch(two[:, None], np.zeros(1), np.zeros((2, 3, 3)))
    _warm_up_around(two, scalar, floats)
    return True


def _warm_up_around(two: Array, held: Array, floats: Array) -> None:
    one, commands, given = np.ones(2), np.zeros((2, 8, 3)), np.zeros((12, 2, 3))
    before = tuple([(1.0,) * length for length in (2, 8, 9, 3, 3, 6, 2, 4, 2)])
    after = tuple([(1.0,) * length for length in (2, 3, 3)])
    arrays = (two,) * 9, (two,) * 5, (one,) * 14
    before_batch(*arrays, commands, two, held, before, given, np.zeros((4, 2)), commands.copy(), floats)
    out = np.zeros((3, 2, 3)), np.zeros((2, 4)), np.zeros((6, 2)), two.copy(), held.copy()
    after_batch(np.zeros((2, 6)), floats, given, one, (one,) * 3, two, held, after, *out)
