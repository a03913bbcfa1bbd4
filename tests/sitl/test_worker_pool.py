"""Processes that fly for another one: they end with it, and a lost one is told in a sentence."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from onboard.config.config_error import ConfigError
from sitl.worker_pool import worker_pool

PARENT = """\
import os, time
from sitl.worker_pool import worker_pool

if __name__ == "__main__":
    with worker_pool(1) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        time.sleep(60.0)
"""
_ENDS_WITHIN_S = 10.0


def is_running(pid: int) -> bool:
    """Whether a process exists that has not ended; the ended one of a dead parent may remain."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as stat:
            state = stat.read().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_a_worker_ends_when_its_parent_is_killed(tmp_path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, str(script)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        assert is_running(worker)
        parent.send_signal(signal.SIGKILL)

        deadline_s = time.monotonic() + _ENDS_WITHIN_S
        while is_running(worker):
            assert time.monotonic() < deadline_s, "the worker outlives its parent"
            time.sleep(0.01)


def test_a_worker_that_is_lost_is_told_with_what_to_do() -> None:
    words = r"A process has ended before its time \(out of memory\?\). Fly with fewer --jobs."
    with pytest.raises(ConfigError, match=words), worker_pool(1) as pool:
        pool.submit(os._exit, 1).result()
