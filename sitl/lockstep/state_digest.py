"""A digest of all state of a lockstep flight, to compare the flight with a repetition of it.

Two flights with the same digest at the same time continue in the same way. The digest covers the
objects of the simulation: vehicles, PX4s, links, motion capture, bus, agents and every random
generator. It reads numbers, words and their containers, and the attributes of all other objects.
Functions, the plan of faults and planned calls are left out, because they are not state.

The ground is left out too. It acts on the fleet only through messages, which are in the bus.
"""

from __future__ import annotations

import enum
import hashlib
import random
from collections import deque
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np

from onboard.config.fleet import FleetConfig
from sitl.faults.catalogue import FaultPlan
from sitl.lockstep.simulation import Simulation

DIGEST_EVERY_S = 2.0

_SKIPPED = (FleetConfig, FaultPlan, msgspec.json.Encoder, msgspec.json.Decoder)
_PLAIN = frozenset((float, int, bool, str, bytes, type(None)))
_HASH_BYTES = 12


def digest(simulation: Simulation) -> str:
    """Return the digest of a simulation as it is now, in hexadecimal digits."""
    return _digest_of(simulation.state_parts())


def _digest_of(value: object) -> str:
    walk = _Walk()
    walk.add(value)
    text = "\0".join(walk.words)
    return hashlib.blake2b(text.encode(), digest_size=_HASH_BYTES).hexdigest()


class _Walk:
    """Visits objects, each of them once, and writes their content as a list of words.

    Attributes:
        words: the words of all values so far.
    """

    def __init__(self) -> None:
        self.words: list[str] = []
        # id() of each visited object -> its number. The objects are kept alive, so that no other
        # object gets the same id().
        self._numbers: dict[int, int] = {}
        self._alive: list[object] = []

    def add(self, value: Any) -> None:
        """Add a value and all values that it contains."""
        kind = type(value)
        if kind in _PLAIN:
            self.words.append(repr(value))
            return
        if isinstance(value, enum.Enum):
            self.words.append(value.name)
            return
        if callable(value) or isinstance(value, _SKIPPED) or self._is_known(value):
            return

        self.words.append(kind.__qualname__)
        if isinstance(value, (list, tuple, deque)):
            self.words.append(str(len(value)))
            for member in value:
                self.add(member)
        elif isinstance(value, dict):
            self.words.append(str(len(value)))
            for key, member in value.items():
                self.add(key)
                self.add(member)
        elif isinstance(value, (set, frozenset)):
            # a set has no repeatable order
            self.words.extend(sorted(_digest_of(member) for member in value))
        elif isinstance(value, (np.ndarray, np.generic)):
            self.words.append(f"{value.dtype} {value.shape} {value.tobytes().hex()}")
        elif isinstance(value, np.random.Generator):
            self.add(value.bit_generator.state)
        elif isinstance(value, random.Random):
            self.add(value.getstate())
        else:
            for name in _attributes(value):
                self.words.append(name)
                self.add(getattr(value, name, None))

    def _is_known(self, value: object) -> bool:
        """Return whether an object was visited before; if so, write its number in its place."""
        number = self._numbers.get(id(value))
        if number is not None:
            self.words.append(str(number))
            return True
        self._numbers[id(value)] = len(self._numbers)
        self._alive.append(value)
        return False


def _attributes(value: object) -> Iterable[str]:
    """Return the names of an object's attributes, in a repeatable order."""
    if isinstance(value, msgspec.Struct):
        return value.__struct_fields__

    names = set(getattr(value, "__dict__", ()))
    for kind in type(value).__mro__:
        slots = kind.__dict__.get("__slots__", ())
        if isinstance(slots, str):  # a single slot may be written without a list
            slots = [slots]
        names.update(slots)
    return sorted(names)
