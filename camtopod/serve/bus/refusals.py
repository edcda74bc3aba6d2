"""Count and log who was refused by zenoh, and which messages were dropped.

Zenoh reports refusals only in its log, which it writes to standard output, so the log is read from
there.
"""

from __future__ import annotations

import collections
import contextlib
import logging
import os
import re
import threading
import time
from collections.abc import Iterator

from camtopod.keys import rules

log = logging.getLogger(__name__)

FILTER = (
    "zenoh_link_tls=warn,zenoh::net::routing::interceptor=trace,zenoh::net::primitives::demux=trace"
)
"""The parts of zenoh's log that are needed; the environment variable RUST_LOG can ask for more.

The decisions of access control are logged at level trace only, a line for each message. ``demux``
writes no lines of its own: it adds the session of the sender to the others.
"""
FILTER_WITH_SIZES = f"{FILTER},zenoh_transport::unicast::universal::rx=trace"
"""`FILTER`, and messages that are too large to be reassembled from their fragments.

These, too, are logged at level trace only, where every message is logged with its bytes: 6 us of
CPU time for a message of 150 bytes. So this filter is used only with authentication.
"""
LOG_INTERVAL_SECONDS = 60.0
"""Shortest time between two log lines for the same reason, in seconds."""
LINE_BYTES_MAX = 4096
"""Longest part of a log line that is read, in bytes."""
_REASONS = {
    "no-certificate": r"peer sent no certificates",
    "expired": r"invalid peer certificate: .*(expired|Expired|not valid yet|NotValidYet)",
    "wrong-authority": (
        r"invalid peer certificate: .*(UnknownIssuer|BadSignature|CaUsedAsEndEntity)"
    ),
    "bad-certificate": r"invalid peer certificate|received fatal alert|signature",
    "not-tls": r"corrupt message|InvalidContentType|InvalidMessage",
}
_INTERCEPTOR = re.compile(
    r"(?P<thread>ThreadId\(\d+\)) (?:demux\{[^}]* src=[^ }/]*/(?P<session>\w+):\d+\}: )?"
    r"zenoh::net::routing::interceptor\S* (?P<what>.*)"
)
_STAMP = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)\S*Z ")
_DECISION = re.compile(
    r"(?:Using cached result: )?(\w+)(?: on \S*CertCommonName\(([^)]*)\)\S*)?"
    r" is (un)?authorized to ([\w/ ]+) \((\w+)\) on (\S+)"
)
_REHEARSAL, _REHEARSED = "caching permissions for", 9
"""The line that announces cached decisions, and the number of lines that follow for one key.

When a key is declared, access control decides in advance about all kinds of messages on it, and
logs a line for each. A message on that key is then logged again, without the certificate's name.
"""
_MARKED = re.compile(r"Overwriting QoS for .*priority: (\w+)")
_LIMITS = {priority.replace("_", ""): limit for priority, limit in rules.PRIORITY_LIMITS.items()}
"""Size limits of `rules.PRIORITY_LIMITS`, by the priority's name as zenoh writes it, in lower
case.
"""
NAMES_MAX = 10_000
"""Most sessions whose certificate is remembered; beyond it all are forgotten."""
_LINK = re.compile(r"zenoh_link_tls\S*: (.*)")
_RECEIVED, _TOO_LARGE = b"unicast::universal::rx", b"Defragmentation buffer full"
_BUFFER = re.compile(r"buffer full: (\d+) bytes\. Capacity: (\d+)")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class Refusals:
    """Counts of refusals by reason. There is one for the process, as there is one log of zenoh."""

    def __init__(self) -> None:
        self.counts: collections.Counter[str] = collections.Counter()
        self._said: dict[str, float] = {}
        # Threads of zenoh whose current message is denied.
        self._denied: set[str] = set()
        # By thread: number of decisions to follow that are made in advance, not of a message.
        self._rehearsing: dict[str, int] = {}
        # By thread: key of the message that was decided on last.
        self._keys: dict[str, str] = {}
        # By thread: size limit that its current message exceeds.
        self._marked: dict[str, tuple[str, str, int]] = {}
        # By session: name of its certificate, or else its address.
        self._names: dict[str, str] = {}

    def on_session(self, session: str, name: str | None, address: str) -> None:
        """Remember the certificate or address of a new session. Called from a thread of the bus."""
        self._remember(session, name or address)

    def read_line(self, line: str) -> None:
        """Evaluate a line of zenoh's log."""
        line = _COLOUR.sub("", line).strip()

        # A message whose fragments exceed the buffer.
        if _TOO_LARGE.decode() in line:
            found = _BUFFER.search(line)
            size, most = found.groups() if found is not None else ("many", "fewer")
            self._count(
                "too-large",
                f"a message of more than {size} bytes was dropped{_when(line)}: "
                f"the bus takes {most}",
            )
            return

        # A decision of access control, a size limit, or a dropped message.
        intercepted = _INTERCEPTOR.search(line)
        if intercepted is not None:
            self._intercepted(
                intercepted["thread"], intercepted["session"], intercepted["what"], _when(line)
            )
            return

        # A connection that was refused; other lines are passed on.
        link = _LINK.search(line)
        if link is None:
            if line:
                log.info("zenoh: %s", line)
            return
        what = link.group(1).partition(". Hint:")[0]
        reason = next(
            (reason for reason, words in _REASONS.items() if re.search(words, what)), "other"
        )
        self._count(reason, f"a connection to the bus was refused: {reason} ({what})")

    def _intercepted(self, thread: str, session: str | None, what: str, when: str) -> None:
        """Evaluate a line about a message: decided on, over a size limit, or dropped.

        Where there are size limits, zenoh also drops messages without a key. They are not counted:
        a client's session sends one by itself when a query to its program is not answered in time.
        """
        if _REHEARSAL in what:
            self._rehearsing[thread] = _REHEARSED
        elif decision := _DECISION.match(what):
            self._decided(thread, *decision.groups())
        elif marked := _MARKED.match(what):
            # Without a limit it is a query, see `rules.ANSWERS`.
            if (limit := _LIMITS.get(marked[1].lower())) is not None:
                self._marked[thread] = limit
        elif what.startswith("Msg intercepted"):
            over, key = self._marked.pop(thread, None), self._keys.pop(thread, None)
            if thread in self._denied:
                self._denied.discard(thread)
            elif over is not None:
                self._too_large(session, key, over, when)

    def _decided(
        self,
        thread: str,
        session: str,
        name: str | None,
        un: str | None,
        action: str,
        way: str,
        key: str,
    ) -> None:
        """Evaluate a decision of access control; its parts are the groups of `_DECISION`."""

        # A decision with a name is a fresh one: skip it if it was made in advance.
        if name is not None:
            self._remember(session, name)
            if self._rehearsing.get(thread, 0):
                self._rehearsing[thread] -= 1
                return

        # A decision on a message.
        self._rehearsing.pop(thread, None)
        self._keys[thread] = key
        if un is None:
            self._denied.discard(thread)
            return
        self._denied.add(thread)
        # Count messages only: a denied declaration has no effect.
        if way == "ingress" and " " not in action:
            who = self._names.get(session, "somebody")
            self._count("denied", f"the certificate of {who} does not allow {action} on {key}")

    def _too_large(
        self, session: str | None, key: str | None, limit: tuple[str, str, int], when: str
    ) -> None:
        """Count a message that was dropped for its size; ``limit``: (kind, keys, bytes)."""
        kind, keys, most = limit
        names = [
            name
            for known, name in list(self._names.items())
            if session and known.startswith(session)
        ]
        who = names[0] if names else f"session {session}" if session else "somebody"
        self._count(
            "too-large",
            f"a {kind} from {who} on {key or keys} was dropped{when}: "
            f"it has more than {most} bytes",
        )

    def _remember(self, session: str, name: str) -> None:
        if len(self._names) >= NAMES_MAX:
            self._names.clear()
        self._names[session] = name

    def _count(self, reason: str, what: str) -> None:
        """Count a refusal, and log it unless one of the same reason was logged recently."""
        self.counts[reason] += 1
        now = time.monotonic()
        if now - self._said.get(reason, -LOG_INTERVAL_SECONDS) >= LOG_INTERVAL_SECONDS:
            self._said[reason] = now
            log.warning("%s (%d so far)", what, self.counts[reason])


def _when(line: str) -> str:
    """Return the time stamp of a line of zenoh's log as `` at TIMEZ``; "" if it has none."""
    stamp = _STAMP.match(line)
    return f" at {stamp[1]}Z" if stamp is not None else ""


refusals = Refusals()
"""The refusals of this process."""


@contextlib.contextmanager
def capture_standard_output() -> Iterator[None]:
    """Send standard output (file descriptor 1) to `refusals` while the block runs."""
    reading, writing = os.pipe()
    saved = os.dup(1)
    os.dup2(writing, 1)
    os.close(writing)
    thread = threading.Thread(target=_hear_all, args=(reading,), name="zenoh-log", daemon=True)
    thread.start()
    try:
        yield
    finally:
        os.dup2(saved, 1)  # closes the last writing end, so the thread ends
        os.close(saved)
        thread.join(1.0)


def _hear_all(reading: int) -> None:
    """Read the log until its end; only the beginning of an overlong line is evaluated."""
    begins = True
    with os.fdopen(reading, "rb") as lines:
        while piece := lines.readline(LINE_BYTES_MAX):
            if begins and (_RECEIVED not in piece or _TOO_LARGE in piece):
                refusals.read_line(piece.decode("utf-8", "replace"))
            begins = piece.endswith(b"\n")
