"""The benchmark of mutants: what it changes, and that it notices a mistake in a room."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench import mutants
from tests.bench.mutants import copied_tree, is_noticed, mutants_of

GEOFENCE = Path("onboard/safety/geofence.py")


def test_each_mutant_differs_from_the_file_and_from_all_others() -> None:
    texts = [mutant.text for mutant in mutants_of(GEOFENCE)]
    assert len(texts) > 5
    assert len(set(texts)) == len(texts)
    for text in texts:
        compile(text, "mutant", "exec")


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_room_without_a_mistake_passes_and_one_with_a_mistake_does_not(tmp_path: Path) -> None:
    tree = copied_tree(tmp_path)
    text = (mutants.ROOT / GEOFENCE).read_text(encoding="utf-8")
    same = mutants.Mutant(GEOFENCE, 0, "nothing", text)
    assert not is_noticed(same, "safety", tree)
    broken = same._replace(text=text.replace("<", ">"))
    assert is_noticed(broken, "safety", tree)
