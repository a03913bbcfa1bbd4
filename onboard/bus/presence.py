"""The names that are present on the bus. Several nodes may declare the same name at once. Pure."""

from __future__ import annotations

from onboard.bus.protocol import OnAlive

_MAX_TOKENS = 20_000  # of all names together; further tokens are ignored


class Presence:
    """Counts the nodes behind each name. A name stays present until its last node has left.

    Args:
        on_alive: called with a name and whether it is present, but only on a change.
    """

    def __init__(self, on_alive: OnAlive) -> None:
        self._on_alive = on_alive
        self._instances: dict[str, set[str]] = {}  # name -> instances of the nodes that declare it
        self._count = 0  # number of instances of all names together

    def see(self, token: str, is_alive: bool) -> None:
        """Note a liveliness token that appeared or vanished.

        Args:
            token: ``NAME/INSTANCE``, where INSTANCE differs from node to node.
            is_alive: whether it appeared; False when it vanished.
        """
        name, _, instance = token.partition("/")
        if is_alive:
            self._add(name, instance)
        else:
            self._remove(name, instance)

    def _add(self, name: str, instance: str) -> None:
        instances = self._instances.get(name, set())
        if instance in instances or self._count >= _MAX_TOKENS:
            return

        self._count += 1
        instances.add(instance)
        if len(instances) == 1:
            self._instances[name] = instances
            self._on_alive(name, True)

    def _remove(self, name: str, instance: str) -> None:
        instances = self._instances.get(name, set())
        if instance not in instances:
            return

        self._count -= 1
        instances.remove(instance)
        if not instances:
            del self._instances[name]
            self._on_alive(name, False)
