"""What was freed is given back."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import threading, sys
from pathlib import Path
from camtopod.serve import memory
if sys.argv[1] == "limited":
    memory.limit_arenas()

def work(kept):
    mine = [bytearray(3000) for _ in range(20000)]
    kept.append(mine[::100])

kept = []
for _ in range(6):
    threads = [threading.Thread(target=work, args=(kept,)) for _ in range(4)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
if sys.argv[1] == "limited":
    memory.give_back()
print(int(Path("/proc/self/statm").read_text().split()[1]))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="glibc only")
def test_threads_that_come_and_go_leave_less_behind() -> None:
    pages = {
        how: int(subprocess.run([sys.executable, "-c", PROGRAM, how], capture_output=True, check=True).stdout)
        for how in ("limited", "as it is")
    }
    assert pages["limited"] < 0.8 * pages["as it is"]
