"""What our MCAP writer writes, mcap's own reader reads: chunks, indexes, statistics and checksums."""

from __future__ import annotations

import io

import pytest
from mcap.reader import NonSeekingReader, SeekingReader

from groundstation.recording.mcap_file import CHUNK_BYTES, McapFile


def _file(messages: int, size: int) -> tuple[bytes, list[tuple[str, int, bytes]]]:
    stream, expected = io.BytesIO(), []
    file = McapFile(stream, "covey")
    schema = file.register_schema("covey.Test", "jsonschema", b"{}")
    channels = [file.register_channel(f"test/{name}", "json", schema) for name in "abc"]
    for count in range(messages):
        place, stamp_ns, data = count % 3, 1_000_000 * (count ^ 3), bytes([count % 251]) * size
        file.add_message(channels[place], stamp_ns, count // 3, data)
        expected.append((f"test/{'abc'[place]}", stamp_ns, data))
    file.finish()
    return stream.getvalue(), expected


@pytest.mark.parametrize(("messages", "size"), [(0, 1), (1, 0), (3, 10), (2000, 700)])
def test_mcaps_readers_find_every_message_with_valid_checksums(messages: int, size: int) -> None:
    data, expected = _file(messages, size)
    for reader in (SeekingReader(io.BytesIO(data), validate_crcs=True), NonSeekingReader(io.BytesIO(data))):
        found = [(channel.topic, message.log_time, message.data) for _, channel, message in reader.iter_messages()]
        assert sorted(found) == sorted(expected)


def test_the_summary_counts_and_the_index_finds_a_time_and_a_channel() -> None:
    data, expected = _file(2000, 700)
    reader = SeekingReader(io.BytesIO(data), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 2000
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) >= 2000 * 700 // (CHUNK_BYTES + 1000) > 1
    assert sorted(summary.statistics.channel_message_counts.values()) == [666, 667, 667]
    assert {channel.topic for channel in summary.channels.values()} == {"test/a", "test/b", "test/c"}
    begin, end = 300_000_000, 310_000_000
    found = [m.log_time for _, _, m in reader.iter_messages(topics=["test/b"], starting_at=begin, ending_before=end)]
    assert found == sorted(stamp for topic, stamp, _ in expected if topic == "test/b" and begin <= stamp < end)
