"""Evidence for an authority: what a fleet did in simulated flights in which something failed.

``covey evidence`` flies the campaign (``sitl/lockstep/campaign``) and writes the page from here.
"""
