"""A table of the corpus: what came of each file, how long it took, and how much memory.

``python -m tests.groundstation.hostile_files.measure`` prints it.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.groundstation.hostile_files.corpus import CORPUS
from tests.groundstation.hostile_files.reading import outcome_in_process, warm_up


def main() -> None:
    """Print a row for each file."""
    warm_up()
    for name, hostile in CORPUS.items():
        with tempfile.TemporaryDirectory() as folder:
            path = hostile.make(Path(folder))
            size = 0
            if path.is_file():
                size = path.stat().st_size
            outcome = outcome_in_process(hostile.door, path)
        print(
            f"| {name} | {size / 1000:.0f} kB | {outcome.kind} | {outcome.seconds:.2f} s | "
            f"{outcome.memory_mb:.0f} MB | {outcome.sentence[:150]} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
