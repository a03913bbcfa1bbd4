"""Go or no-go with the emulator's faults: what breaks before take-off shows in its line, and goes
when it is mended.
"""

from __future__ import annotations

import pytest

from sitl.faults.catalogue import Fault

# three at a time, one on each vehicle: fault, its parameters, the line that it shows in, and words
# of that line
ROUNDS: list[list[tuple[str, dict[str, float | str], str, str]]] = [
    [
        ("mocap_lost", {}, "position", "mocap body 'mav0'"),
        ("mocap_late", {"delay_s": 2.0}, "clock", "in the past"),
        ("link_loss", {"share": 1.0, "direction": "out"}, "px4", "PX4 is not heard"),
    ],
    [
        ("mocap_frozen", {}, "failsafe", "Mocap repeats itself"),
        ("vision_jump", {"east_m": 2.0}, "agreement", "from where the mocap measures"),
        ("autopilot_hang", {}, "px4", "PX4 is not heard"),
    ],
]


def _refusals(flight, name):
    view = flight.state.vehicles[name]
    assert view.has_preflight(flight.client.now_ns())
    return {check: sentence for check, is_ok, sentence, _ in view.preflight.checks if not is_ok}


@pytest.mark.long
def test_each_fault_on_the_ground_shows_in_its_line_and_refuses_the_take_off(lockstep, paper):
    flight = lockstep(paper, seed=3)
    flight.ready()
    flight.run(2.0)
    for faults in ROUNDS:
        assert not any(_refusals(flight, name) for name in paper.enabled_names)
        for name, (kind, parameters, _, _) in zip(paper.enabled_names, faults, strict=True):
            flight.inject(
                Fault(
                    name=kind,
                    vehicle=name,
                    at_s=flight.time_s,
                    duration_s=5.0,
                    parameters=parameters,
                )
            )
        flight.run(4.5)
        results = flight.order("takeoff all 1.0")
        for name, (_, _, line, words) in zip(paper.enabled_names, faults, strict=True):
            found = _refusals(flight, name)
            assert words in found[line], name
            # whoever has no position is not there for the others
            assert set(found) - {line} <= {"neighbours"}, (name, found)
            assert results[name].phase == "refused"
            assert flight.state.vehicles[name].truth.position_enu_m[2] < 0.05
        flight.run(9.0)
    assert not any(_refusals(flight, name) for name in paper.enabled_names)


def test_two_bodies_that_are_swapped_from_the_start_are_found_before_take_off(lockstep, paper):
    flight = lockstep(paper, seed=3)
    flight.inject(Fault("mocap_swapped", "mav0", parameters={"other": "mav2"}))
    flight.run(5.0)
    assert "on the take-off spot of mav2" in _refusals(flight, "mav0")["spot"]
    assert "on the take-off spot of mav0" in _refusals(flight, "mav2")["spot"]
    assert "spot" not in _refusals(flight, "mav1")
    results = flight.order("takeoff all 1.0")
    assert results["mav0"].phase == results["mav2"].phase == "refused"
