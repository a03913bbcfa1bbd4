"""The network of a fleet: checks of its bus, links, keys and this computer, and attacks on a copy.

``covey check computer``, ``covey check attack`` and the findings of ``covey check`` come from here.
"""
