"""Names on the bus, each of which several nodes may declare at once. Pure."""

from __future__ import annotations

from onboard.bus.protocol import OnAlive

_MAX_TOKENS = 20_000


class Presence:
    """Counts the nodes behind each name: a second node of a name does not take it along when it
    leaves.

    Args:
        on_alive: called with the name and whether it is there, only when that changes.
    """

    def __init__(self, on_alive: OnAlive) -> None:
        self._on_alive = on_alive
        # name -> what distinguishes the nodes that declare it
        self._tokens: dict[str, set[str]] = {}
        self._count = 0

    def see(self, token: str, is_alive: bool) -> None:
        """Take a liveliness token that appeared or vanished.

        Args:
            token: ``NAME/INSTANCE``, where INSTANCE differs from node to node.
            is_alive: whether it appeared; False when it vanished.
        """
        name, _, instance = token.partition("/")
        known = self._tokens.get(name)
        if is_alive:
            if self._count >= _MAX_TOKENS or (known is not None and instance in known):
                return
            self._count += 1
            if known is not None:
                known.add(instance)
                return
            self._tokens[name] = {instance}
        elif known is None or instance not in known:
            return
        else:
            self._count -= 1
            known.discard(instance)
            if known:
                return
            del self._tokens[name]
        self._on_alive(name, is_alive)
