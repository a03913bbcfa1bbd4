"""A program on a host of its own: ``python -m tests.bench.network.host HUB ADDRESS MODULE
WORDS...``.
"""

from __future__ import annotations

import runpy
import sys

from tests.bench.network.hub import join

if __name__ == "__main__":
    hub, address, module, *words = sys.argv[1:]
    line = join(hub, address)  # before any library starts a thread
    sys.argv = [module, *words]
    runpy.run_module(module, run_name="__main__", alter_sys=True)
