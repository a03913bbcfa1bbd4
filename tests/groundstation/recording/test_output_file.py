"""What ``--out`` may write over."""

from __future__ import annotations

from pathlib import Path

import pytest

from groundstation.recording.output_file import refuse_other_file
from onboard.config.fleet import ConfigError


def _is_own(begin: bytes) -> bool:
    return begin.startswith(b"OWN")


@pytest.mark.parametrize("content", [None, b"", b"OWN 1"])
def test_a_new_an_empty_and_an_own_file_may_be_written(
    content: bytes | None, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    if content is not None:
        out.write_bytes(content)
    refuse_other_file(out, _is_own, other="is none of ours")


def test_a_file_of_somebody_else_is_refused_in_words(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.write_bytes(b"mine")
    with pytest.raises(ConfigError, match="there already and is none of ours, so it is not over"):
        refuse_other_file(out, _is_own, other="is none of ours")
