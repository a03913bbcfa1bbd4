"""Detects two agents that publish under one name.

Every start of an agent has a new boot id, so a restarted agent never publishes an earlier boot id.
If an earlier boot id is heard again, two agents are running. Two agents of one vehicle are not
connected to each other, but both are connected to the rest of the fleet. Therefore another agent
that hears both reports their name in its telemetry (``doubles``), and the two learn of each other
from it. To people such a duplicate is the condition TWIN, and fails the preflight rule "alone".
"""

from __future__ import annotations

from dataclasses import dataclass, field

_DUPLICATE_FOR_NS = 2_000_000_000  # a name counts as that of two agents for this time
_MAX_BOOT_IDS = 16  # number of remembered earlier boot ids per name


@dataclass(slots=True)
class DuplicateAgents:
    """Memory of the boot ids under every name."""

    _newest: dict[str, int] = field(default_factory=dict)  # name -> newest boot id
    _before: dict[str, list[int]] = field(default_factory=dict)  # name -> earlier boot ids
    # name -> when an earlier boot id was last heard again
    _repeated_ns: dict[str, int] = field(default_factory=dict)

    def hear(self, name: str, boot_id: int, received_ns: int) -> None:
        """Note the boot id of a message."""
        newest = self._newest.get(name)
        if boot_id == newest:
            return

        self._newest[name] = boot_id
        if newest is None:
            return

        before = self._before.setdefault(name, [])
        if boot_id in before:
            self._repeated_ns[name] = received_ns  # the earlier agent publishes again, so both run
        if newest not in before:
            before.append(newest)
            del before[:-_MAX_BOOT_IDS]

    def names(self, now_ns: int) -> tuple[str, ...]:
        """Return the names that two agents currently use, sorted."""
        names = []
        for name, repeated_ns in self._repeated_ns.items():
            if now_ns - repeated_ns < _DUPLICATE_FOR_NS:
                names.append(name)
        return tuple(sorted(names))
