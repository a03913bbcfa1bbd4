"""The methods with their chosen values under the names that a fleet file or ``--law`` can give."""

from __future__ import annotations

from tests.bench.peers.methods import METHODS
from tests.bench.peers.stage import covey as covey
from tests.bench.peers.stage import law_of

orca, cells, certificate, robust_certificate, potential = (
    law_of(METHODS[name].step, METHODS[name].chosen)
    for name in ("orca", "cells", "certificate", "robust_certificate", "potential")
)
