"""Words on an order that vehicles did not do."""

from __future__ import annotations

from groundstation.orders.intents import Takeoff
from groundstation.orders.result import OrderFailed, VehicleResult

NOT_READY = "The motion capture does not see it."


def refused(name: str, sentence: str) -> VehicleResult:
    return VehicleResult(vehicle=name, order_id="", phase="refused", sentence=sentence)


def test_a_failed_order_names_each_vehicle_once_and_each_reason_once() -> None:
    results = {
        "mav0": refused("mav0", "mav0: the goal lies outside the fence."),
        "mav1": refused("mav1", NOT_READY),
        "mav2": refused("mav2", NOT_READY),
    }

    error = OrderFailed(Takeoff(vehicles=("mav0", "mav1", "mav2"), height_m=1.0), results)

    assert str(error) == (
        "'takeoff mav0,mav1,mav2 1' failed. mav0 refused: the goal lies outside the fence. "
        f"mav1, mav2 refused: {NOT_READY}"
    )


def test_a_result_begins_with_the_name_of_its_vehicle_once() -> None:
    of_the_ground = refused("mav0", "mav0: the goal lies outside the fence.")
    of_the_agent = refused("mav0", NOT_READY)

    assert of_the_ground.words == "mav0 refused: the goal lies outside the fence."
    assert of_the_agent.words == f"mav0 refused: {NOT_READY}"
