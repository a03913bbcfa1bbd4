"""Orders between two sleeps of a script: of each vehicle only the last one is sent."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from groundstation.crazyswarm.orders import ScriptOrders
from groundstation.orders.grammar import OrderError


class Standing:
    """A fleet whose vehicles stand on the ground."""

    def __init__(self) -> None:
        self.client = SimpleNamespace(now_ns=lambda: 0)

    def __getitem__(self, name: str) -> Any:
        return SimpleNamespace(is_flying=False)


@pytest.fixture
def orders() -> ScriptOrders:
    fleet: Any = Standing()
    blocking: Any = SimpleNamespace(run=lambda _: fleet)
    return ScriptOrders(blocking)


def test_a_take_off_replaces_a_stop_before_it(orders: ScriptOrders) -> None:
    orders.stop("mav0")
    orders.stop("mav1")
    orders.takeoff("mav0", 1.0, 2.0)
    assert orders._batch.stops == ["mav1"], "mav0 would be disarmed while it takes off"
    assert list(orders._batch.takeoffs) == ["mav0"]


def test_a_stop_replaces_arming_and_a_take_off_and_follows_a_landing(orders: ScriptOrders) -> None:
    orders.arm("mav0")
    orders.takeoff("mav1", 1.0, 2.0)
    orders.land("mav2", 2.0)
    for name in ("mav0", "mav1", "mav2"):
        orders.stop(name)
    assert orders._batch.arms == []
    assert orders._batch.takeoffs == {}
    assert orders._batch.landings == {"mav2": 2.0}
    assert orders._batch.stops == ["mav0", "mav1", "mav2"]


def test_arming_replaces_a_stop_before_it(orders: ScriptOrders) -> None:
    orders.stop("mav0")
    orders.arm("mav0")
    assert orders._batch.stops == []
    assert orders._batch.arms == ["mav0"]


def test_an_emergency_drops_what_is_not_sent_and_refuses_what_would_fly(
    orders: ScriptOrders,
) -> None:
    orders.takeoff("mav0", 1.0, 2.0)
    orders.kill_all()
    assert orders._batch.takeoffs == {}, "mav0 would take off after its motors were stopped"

    with pytest.raises(OrderError, match=r"goTo is refused, because emergency\(\) has stopped"):
        orders.go_to("mav0", (0.0, 0.0, 1.0), 0.0, 2.0)
    with pytest.raises(OrderError, match="takeoff is refused"):
        orders.takeoff("mav1", 1.0, 2.0)
    with pytest.raises(OrderError, match="arm is refused"):
        orders.arm("mav1")
    assert orders._batch.moves == {}
