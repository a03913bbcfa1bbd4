"""The JSON schemas of a record, in the words that viewers know."""

from __future__ import annotations

import json
from typing import Any

import pytest

from groundstation.recording.channels import KINDS, json_schema
from onboard.bus.schema import Message, Order, PreflightReport, Telemetry

# Lichtblick's reader of JSON schemas, packages/mcap-support/src/parseJsonSchema.ts, refuses a
# channel with any other type, and all arrays of arrays.
ITEMS = {"boolean", "integer", "number", "object", "string"}


def fields(kind: type[Message]) -> dict[str, Any]:
    schema = json.loads(json_schema(kind))
    assert schema["type"] == "object"
    found: dict[str, Any] = schema["properties"]
    return found


@pytest.mark.parametrize("name", KINDS)
def test_every_field_has_a_type_that_viewers_know(name: str) -> None:
    for field, schema in fields(KINDS[name]).items():
        assert schema["type"] in {*ITEMS, "array"}, field
        if schema["type"] == "array":
            assert schema["items"]["type"] in ITEMS, field


def test_a_choice_of_words_is_a_string_and_null_is_not_mentioned() -> None:
    state = fields(Telemetry)["state"]
    assert state["type"] == "string"
    assert "flying" in state["enum"]

    order = fields(Order)
    assert order["height_m"] == {"type": "number"}
    assert order["position_enu_m"] == {"type": "array", "items": {"type": "number"}}


def test_only_a_field_that_these_words_cannot_describe_is_left_out() -> None:
    left_out = {
        name: sorted(set(kind.__struct_fields__) - set(fields(kind)))
        for name, kind in KINDS.items()
        if len(fields(kind)) < len(kind.__struct_fields__)
    }
    assert left_out == {
        "ClockMessage": ["heard"],
        "MocapPoses": ["poses"],
        "Order": ["path"],
        "PreflightReport": ["checks"],
        "TickBatch": ["ticks"],
    }
    assert "px4_version" in fields(PreflightReport)
