"""Crazyswarm's API for Covey's fleet: a script of Crazyswarm flies with another import line.

docs/crazyswarm.md explains it.
"""

from groundstation.crazyswarm.swarm import Crazyswarm as Crazyswarm

__all__ = ["Crazyswarm"]
