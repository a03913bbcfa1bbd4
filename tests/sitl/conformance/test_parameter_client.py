"""Parameters of a vehicle behind a link that loses messages: set, and restored or named."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from sitl.conformance.facts import FactReport, FactVerdict, matching
from sitl.conformance.suite import FACTS, Terms, check
from sitl.conformance.vehicle_client import VehicleClient
from tests.sitl.conformance.mutants import editing
from tests.sitl.conformance.virtual import Wires

NAME = "COM_OF_LOSS_T"


class LosingSets:
    """A link from the client on which the next messages PARAM_SET are lost."""

    def __init__(self) -> None:
        self.to_lose = 0
        self.change = editing(PARAM_SET=self._edit)

    def _edit(self, message: Any) -> Sequence[Any]:
        if self.to_lose:
            self.to_lose -= 1
            return ()
        return (message,)


@pytest.fixture
def losing() -> LosingSets:
    return LosingSets()


@pytest.fixture
def client(losing: LosingSets) -> VehicleClient:
    """A client that the vehicle has answered."""
    wires = Wires()
    wires.incoming = losing.change
    met = VehicleClient(wires.companion())
    met.system_id = 1
    met.greet(as_ground_station=False)
    met.wait(1.5)
    return met


def test_a_value_that_is_lost_is_sent_again(client: VehicleClient, losing: LosingSets) -> None:
    losing.to_lose = 1
    assert client.params.set(NAME, 0.7) == pytest.approx(0.7)
    losing.to_lose = 2
    client.params.restore()
    assert client.params.read(NAME) == 1.0
    assert client.params.changed == {}


def test_a_value_that_is_not_confirmed_stays_to_be_restored(
    client: VehicleClient, losing: LosingSets
) -> None:
    client.params.set(NAME, 0.7)
    losing.to_lose = 3
    client.params.restore()
    assert client.params.changed == {NAME: 1.0}
    client.params.restore()
    assert client.params.changed == {}
    assert client.params.read(NAME) == 1.0


def test_a_check_names_the_parameters_that_it_could_not_put_back() -> None:
    wires = Wires()
    wires.incoming = editing(PARAM_SET=lambda set_: () if set_.param_value == 2.0 else (set_,))
    report = FactReport(matching(FACTS, ["param.set-float"]))
    said: list[str] = []
    check(wires.companion(), None, report, Terms(), said.append)
    assert report.count(FactVerdict.AGREES) == 1
    (line,) = [line for line in said if line.startswith("afterwards: ")]
    assert "former values again: COM_DISARM_LAND = 2. Set them yourself." in line
