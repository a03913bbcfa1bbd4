"""Crazyswarm's names for Covey's fleet: change the import line of a script, and it flies;
docs/crazyswarm.md.
"""

from groundstation.crazyswarm.swarm import Crazyswarm as Crazyswarm

__all__ = ["Crazyswarm"]
