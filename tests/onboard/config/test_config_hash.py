"""The hash of a fleet file, by which agents and grounds know that they have the same one."""

from __future__ import annotations

from pathlib import Path

import msgspec

from onboard.config.fleet import load_fleet

_FLEETS = Path(__file__).parents[3] / "configs/fleets"
_PAPER = _FLEETS / "paper.toml"


def test_a_key_that_no_file_had_before_leaves_the_hash_of_earlier_versions() -> None:
    """A ground that alone is updated would refuse to fly all its vehicles."""
    fleet = load_fleet(_PAPER)
    assert fleet.config_hash == "edc29f06848a", "anew only if the file's own values have changed"

    law = msgspec.structs.replace(fleet.law, paper_margin_m=0.01)
    assert msgspec.structs.replace(fleet, law=law).config_hash != fleet.config_hash


def test_who_is_emulated_is_no_value_of_the_vehicles() -> None:
    """A console with the fleet file connects to a rehearsal, whose copy emulates all."""
    fleet = load_fleet(_FLEETS / "mixed.toml")
    assert fleet.emulated_names
    vehicles = {
        name: msgspec.structs.replace(vehicle, emulated=False)
        for name, vehicle in fleet.vehicles.items()
    }
    assert msgspec.structs.replace(fleet, vehicles=vehicles).config_hash == fleet.config_hash
