"""Who was not let in: zenoh says so in its log only, which it writes to standard output; so read it from there."""

from __future__ import annotations

import collections
import contextlib
import logging
import os
import re
import threading
import time
from collections.abc import Iterator

log = logging.getLogger(__name__)

FILTER = "zenoh_link_tls=warn"
"""What of zenoh's log is wanted; the environment variable RUST_LOG asks for more."""
SAY_SECONDS = 60.0
"""Each reason is said at most this often."""
LINE_BYTES_MAX = 4096
_REASONS = {
    "no-certificate": r"peer sent no certificates",
    "expired": r"invalid peer certificate: .*(expired|Expired|not valid yet|NotValidYet)",
    "wrong-authority": r"invalid peer certificate: .*(UnknownIssuer|BadSignature|CaUsedAsEndEntity)",
    "bad-certificate": r"invalid peer certificate|received fatal alert|signature",
    "not-tls": r"corrupt message|InvalidContentType|InvalidMessage",
}
_LINK = re.compile(r"zenoh_link_tls\S*: (.*)")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class Refusals:
    """Counts by reason; one for the process, as zenoh's log is."""

    def __init__(self) -> None:
        self.counts: collections.Counter[str] = collections.Counter()
        self._said: dict[str, float] = {}

    def hear(self, line: str) -> None:
        """A line of zenoh's log."""
        line = _COLOUR.sub("", line).strip()
        link = _LINK.search(line)
        if link is None:
            if line:
                log.info("zenoh: %s", line)
            return
        what = link.group(1).partition(". Hint:")[0]
        reason = next((reason for reason, words in _REASONS.items() if re.search(words, what)), "other")
        self.counts[reason] += 1
        now = time.monotonic()
        if now - self._said.get(reason, -SAY_SECONDS) >= SAY_SECONDS:
            self._said[reason] = now
            log.warning("somebody was not let onto the bus: %s (%s, %d so far)", reason, what, self.counts[reason])


refusals = Refusals()


@contextlib.contextmanager
def standard_output_heard() -> Iterator[None]:
    """While the block runs, what is written to the file descriptor of standard output goes to `refusals`."""
    reading, writing = os.pipe()
    saved = os.dup(1)
    os.dup2(writing, 1)
    os.close(writing)
    thread = threading.Thread(target=_hear_all, args=(reading,), name="zenoh-log", daemon=True)
    thread.start()
    try:
        yield
    finally:
        os.dup2(saved, 1)  # the last writer is gone, so the thread ends
        os.close(saved)
        thread.join(1.0)


def _hear_all(reading: int) -> None:
    with os.fdopen(reading, "rb") as lines:
        while line := lines.readline(LINE_BYTES_MAX):
            refusals.hear(line.decode("utf-8", "replace"))
