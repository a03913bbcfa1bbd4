"""The only place of the emulator that knows numba.

Loops over vehicles run compiled where it is installed. Without numba the same functions are
interpreted: right, and some hundred times slower.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

# An array with one record per vehicle, and one record of it. The dtype beside each use names the
# fields.
Records = NDArray[np.void]
Record = Any

Function = TypeVar("Function", bound=Callable[..., Any])

try:
    from numba import njit

    HAS_NUMBA = True
except ImportError:
    HAS_NUMBA = False


def compiled(function: Function) -> Function:
    """Compile a function at its first call; without numba return it as it is.

    The result is kept on disk and renewed when the function's file changes, so a compiled function
    calls only those of its file.
    """
    if not HAS_NUMBA:
        return function
    return cast(Function, njit(cache=True)(function))


def records(shape: int | tuple[int, ...], dtype: np.dtype[np.void]) -> Records:
    """Return zeroed records whose fields compiled and interpreted functions read as attributes."""
    array = np.zeros(shape, dtype)
    return array if HAS_NUMBA else array.view(np.recarray)
