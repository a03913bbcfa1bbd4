"""What comes from outside never raises: it decodes, or it is Malformed."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.bus import schema
from onboard.bus.codec import MAX_BYTES, Malformed, decode, encode, is_finite
from onboard.bus.topics import TOPICS, Topic, key, topic_and_name

EVENT = schema.Event(vehicle="mav0", stamp_ns=5, severity="info", code="armed", sentence="Armed.")
KINDS = [spec.message for spec in TOPICS.values() if spec.message is not None]


def test_a_message_survives_encoding() -> None:
    assert decode(encode(EVENT), schema.Event) == EVENT


def test_every_truncation_is_malformed() -> None:
    data = encode(EVENT)
    for length in range(len(data)):
        assert isinstance(decode(data[:length], schema.Event), Malformed)


def test_another_type_and_another_version_are_malformed() -> None:
    assert isinstance(decode(encode(EVENT), schema.StateMessage), Malformed)
    newer = schema.Event(
        schema=99, vehicle="mav0", stamp_ns=5, severity="info", code="x", sentence="y"
    )
    answer = decode(encode(newer), schema.Event)
    assert isinstance(answer, Malformed)
    assert "version 99" in answer.reason


def test_a_huge_message_is_malformed() -> None:
    assert isinstance(decode(b"\x00" * (MAX_BYTES + 1), schema.Event), Malformed)


@settings(max_examples=300, deadline=None)
@given(data=st.binary(max_size=200), kind=st.sampled_from(KINDS))
def test_garbage_never_raises(data: bytes, kind: type[schema.Message]) -> None:
    assert isinstance(decode(data, kind), (Malformed, kind))


@settings(max_examples=300, deadline=None)
@given(position=st.integers(0, 60), value=st.integers(0, 255))
def test_a_flipped_byte_never_raises(position: int, value: int) -> None:
    data = bytearray(encode(EVENT))
    data[position % len(data)] = value
    assert isinstance(decode(bytes(data), schema.Event), (Malformed, schema.Event))


def test_finite_sees_every_number() -> None:
    assert is_finite((1.0, 2.0), (3.0,))
    assert not is_finite((1.0, math.nan), (3.0,))
    assert not is_finite((1.0,), (math.inf,))


def test_keys_and_topics_are_inverse() -> None:
    for topic in Topic:
        assert topic_and_name("covey/paper", key("covey/paper", topic, "mav0")) == (topic, "mav0")
    assert topic_and_name("covey/paper", "covey/other/state/mav0") is None
    assert topic_and_name("covey/paper", "covey/paper/nothing/mav0") is None
    assert topic_and_name("covey/paper", "covey/paper/state/a/b") is None


def test_every_topic_is_in_the_table() -> None:
    assert set(TOPICS) == set(Topic)
