"""Compilation by numba, which no other module of the emulator imports.

Loops over vehicles are compiled where numba is installed. Without numba the same functions are
interpreted, with the same results but hundreds of times slower.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

# Records is an array with one record per vehicle, Record is one record of it. The dtype beside each
# use names the fields.
Records = NDArray[np.void]
Record = Any

Function = TypeVar("Function", bound=Callable[..., Any])

try:
    from numba import njit

    HAS_NUMBA = True
except ImportError:
    HAS_NUMBA = False


def compiled(function: Function) -> Function:
    """Return a function that is compiled at its first call, or the function itself without numba.

    The machine code is stored on disk and renewed when the file of the function changes. Changes
    in other files do not renew it, so a compiled function calls only functions of its file.
    """
    if not HAS_NUMBA:
        return function
    return cast(Function, njit(cache=True)(function))


def records(shape: int | tuple[int, ...], dtype: np.dtype[np.void]) -> Records:
    """Return zeroed records whose fields compiled and interpreted functions read as attributes."""
    array = np.zeros(shape, dtype)
    if HAS_NUMBA:
        return array
    return array.view(np.recarray)
