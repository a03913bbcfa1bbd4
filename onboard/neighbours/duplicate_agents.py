"""Does one name speak with two voices? Every start of an agent has a boot id, and a restarted one never hears its last.

Two agents of one vehicle on different hosts are not connected to each other, but both to the rest of the fleet. So who
hears two voices under one name says so in its telemetry, and the two learn of each other from that.
"""

from __future__ import annotations

from dataclasses import dataclass, field

_DOUBLED_FOR_NS = 2_000_000_000
_MOST_LIVES = 16


@dataclass(slots=True)
class DuplicateAgents:
    """Boot ids by name: the newest, those before it, and when one of those was heard again."""

    _newest: dict[str, int] = field(default_factory=dict)
    _before: dict[str, list[int]] = field(default_factory=dict)
    _doubled_ns: dict[str, int] = field(default_factory=dict)

    def hear(self, name: str, boot_id: int, received_ns: int) -> None:
        """A message of a life of ``name``."""
        newest = self._newest.get(name)
        if boot_id == newest:
            return
        self._newest[name] = boot_id
        if newest is None:
            return
        before = self._before.setdefault(name, [])
        if boot_id in before:
            self._doubled_ns[name] = received_ns  # who was succeeded speaks again: both live
        if newest not in before:
            before.append(newest)
            del before[:-_MOST_LIVES]

    def doubled(self, now_ns: int) -> tuple[str, ...]:
        """Names that two agents use at present."""
        if not self._doubled_ns:
            return ()
        return tuple(sorted(name for name, at_ns in self._doubled_ns.items() if now_ns - at_ns < _DOUBLED_FOR_NS))
