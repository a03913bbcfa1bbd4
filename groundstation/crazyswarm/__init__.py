"""Crazyswarm's names for Covey's fleet: change a script's import line, and it flies.

docs/crazyswarm.md says how.
"""

from groundstation.crazyswarm.swarm import Crazyswarm as Crazyswarm

__all__ = ["Crazyswarm"]
