"""Which of the agent's inputs the preflight rules keep."""

from __future__ import annotations

import math

from onboard.agent_inputs import ClocksCompared
from onboard.preflight.preflight_inputs import PreflightInputs


def test_the_clocks_of_grounds_do_not_count_but_that_of_a_vehicle_with_a_similar_name_does() -> (
    None
):
    inputs = PreflightInputs("mav0", "mav0", boot_id=1)
    bounds_s = {"ground-12-ab": math.inf, "watcher-7-cd": math.inf, "ground1": math.inf}
    inputs.hear(ClocksCompared(bounds_s))
    assert inputs.clock_bounds_s == {"ground1": math.inf}
