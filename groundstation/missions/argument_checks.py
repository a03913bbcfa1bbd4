"""Checks of what a Python mission gives to its verbs and conditions, before anything is sent.

Values of an order are checked by its planning. These are all others: times, positions, speeds and
limits. A mission that gives a text instead of a number is told so; without these checks it would
end in flight with an error of Python.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from numbers import Real
from typing import Any

import numpy as np

from onboard.config.fleet import ConfigError
from onboard.tuples import Xyz


def check_duration(duration_s: object, verb: str) -> None:
    """Refuse a duration that is negative, infinite or no number.

    Args:
        duration_s: duration [s], as a mission gives it.
        verb: name of the method, for the refusal.

    Raises:
        ConfigError: it is no duration.
    """
    is_duration = False
    if isinstance(duration_s, Real):
        is_duration = 0.0 <= float(duration_s) < math.inf
    if not is_duration:
        raise ConfigError(
            f"{verb}: {duration_s!r:.80} is no duration. Give a finite number of seconds, at least "
            "0."
        )


def check_timeout(timeout_s: object, verb: str) -> None:
    """Refuse a timeout that is no number; one that is infinite waits for ever.

    Args:
        timeout_s: longest wait [s], as a mission gives it.
        verb: name of the method, for the refusal.

    Raises:
        ConfigError: it is no number.
    """
    if not isinstance(timeout_s, Real) or math.isnan(timeout_s):
        raise ConfigError(f"{verb}: {timeout_s!r:.80} is no timeout. Give a number of seconds.")


def check_number(value: object, verb: str, unit: str) -> None:
    """Refuse what is no finite number.

    Args:
        value: value that a mission gives.
        verb: name of the method or condition, for the refusal.
        unit: unit of the value, in words.

    Raises:
        ConfigError: it is no finite number.
    """
    if not isinstance(value, Real) or not math.isfinite(value):
        raise ConfigError(f"{verb}: {value!r:.80} is no finite number of {unit}. Give one.")


def as_scalar(value: Any) -> Any:
    """Return the number in an array of dimension 0, and everything else as it is.

    Interpolations of SciPy return such arrays.

    Args:
        value: value that a script gives.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        return value.item()
    return value


def as_position(position: object, verb: str) -> Xyz:
    """Return a position, or an offset, as three numbers [m].

    Args:
        position: position that a mission gives.
        verb: name of the method or condition, for the refusal.

    Raises:
        ConfigError: it is not three finite numbers.
    """
    position = as_scalar(position)  # which cannot be iterated as an array
    coordinates = tuple(map(as_scalar, position)) if isinstance(position, Iterable) else ()
    are_finite = all(isinstance(value, Real) and math.isfinite(value) for value in coordinates)
    if len(coordinates) != 3 or not are_finite:
        raise ConfigError(
            f"{verb}: {position!r:.80} is not three finite numbers of metres. Write them like "
            "(1.0, 0.0, 1.2)."
        )
    x, y, z = coordinates
    return (float(x), float(y), float(z))


def as_positions(positions: object, verb: str) -> list[Xyz]:
    """Return several positions, each as three numbers [m].

    Args:
        positions: positions that a mission gives.
        verb: name of the method, for the refusal.

    Raises:
        ConfigError: they are no list, or one of them is not three finite numbers.
    """
    if not isinstance(positions, Iterable):
        raise ConfigError(f"{verb}: {positions!r:.80} is no list of positions. Give one.")
    return [as_position(position, verb) for position in positions]


def as_mapping(values: object, verb: str, what: str, example: str) -> Mapping[Any, Any]:
    """Return values that a mission gives to single vehicles, if it says which.

    Args:
        values: name or index -> value.
        verb: name of the method or condition, for the refusal.
        what: the kind of value in words, for the refusal.
        example: name of a vehicle, for the refusal.

    Raises:
        ConfigError: it is no dictionary.
    """
    if not isinstance(values, Mapping):
        raise ConfigError(
            f"{verb}: {values!r:.80} does not say which vehicle it is for. Give each vehicle its "
            f'{what}, for instance {{"{example}": {what}}}.'
        )
    return values
