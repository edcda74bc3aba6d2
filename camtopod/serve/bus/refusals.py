"""Who was not let in, and what was not let through: zenoh says so in its log only, which it writes
to standard output; so read it from there.
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
"""What of zenoh's log is wanted; the environment variable RUST_LOG asks for more. Of what access
control decides there is no less than everything: a line a message. The last of them writes no
lines: it has each say whose message it is.
"""
FILTER_OF_STRANGERS = f"{FILTER},zenoh_transport::unicast::universal::rx=trace"
"""The same, and what is too large to be put together from its pieces. Of that, too, there is no
less than everything: each message with its bytes, 6 us of a processor (for 150 bytes). So it is for
where somebody is kept out.
"""
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
"""Of a key that is declared access control decides beforehand what of all kinds of messages would
be allowed, a line each; when one comes it says so anew, without the name.
"""
_MARKED = re.compile(r"Overwriting QoS for .*priority: (\w+)")
_LIMITS = {priority.replace("_", ""): limit for priority, limit in rules.MARKS.items()}
"""By the priority's name as zenoh writes it, in small letters."""
NAMES_MAX = 10_000
"""Sessions of which it is remembered whose they are."""
_LINK = re.compile(r"zenoh_link_tls\S*: (.*)")
_RECEIVED, _TOO_LARGE = b"unicast::universal::rx", b"Defragmentation buffer full"
_BUFFER = re.compile(r"buffer full: (\d+) bytes\. Capacity: (\d+)")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class Refusals:
    """Counts by reason; one for the process, as zenoh's log is."""

    def __init__(self) -> None:
        self.counts: collections.Counter[str] = collections.Counter()
        self._said: dict[str, float] = {}
        self._denied: set[str] = set()  # threads of zenoh's whose message in hand is not allowed
        self._rehearsing: dict[
            str, int
        ] = {}  # by thread the decisions to come that are of no message
        self._keys: dict[str, str] = {}  # by thread the key of the message that was decided on last
        self._marked: dict[
            str, tuple[str, str, int]
        ] = {}  # by thread the limit that its message in hand is over
        self._names: dict[str, str] = {}  # by session: its certificate's name, or else its address

    def came(self, session: str, name: str | None, address: str) -> None:
        """A session was opened; from a thread of the bus."""
        self._remember(session, name or address)

    def hear(self, line: str) -> None:
        """A line of zenoh's log."""
        line = _COLOUR.sub("", line).strip()
        if _TOO_LARGE.decode() in line:
            found = _BUFFER.search(line)
            size, most = found.groups() if found is not None else ("many", "fewer")
            self._count(
                "too-large",
                f"a message of more than {size} bytes was dropped{_when(line)}: the bus takes {most}",
            )
            return
        intercepted = _INTERCEPTOR.search(line)
        if intercepted is not None:
            self._intercepted(
                intercepted["thread"], intercepted["session"], intercepted["what"], _when(line)
            )
            return
        link = _LINK.search(line)
        if link is None:
            if line:
                log.info("zenoh: %s", line)
            return
        what = link.group(1).partition(". Hint:")[0]
        reason = next(
            (reason for reason, words in _REASONS.items() if re.search(words, what)), "other"
        )
        self._count(reason, f"somebody was not let onto the bus: {reason} ({what})")

    def _intercepted(self, thread: str, session: str | None, what: str, when: str) -> None:
        """What access control says of a message, or that it is over a limit, or that it is dropped.

        A message that is dropped for neither reason has no key, which zenoh drops wherever there
        are limits. A client's session sends one by itself when a question to its program is not
        answered in time, so it is no fault to count.
        """
        if _REHEARSAL in what:
            self._rehearsing[thread] = _REHEARSED
        elif decision := _DECISION.match(what):
            self._decided(thread, *decision.groups())
        elif marked := _MARKED.match(what):
            if (
                limit := _LIMITS.get(marked[1].lower())
            ) is not None:  # else it is a question, see `rules.ANSWERS`
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
        if name is not None:
            self._remember(session, name)
            if self._rehearsing.get(thread, 0):
                self._rehearsing[thread] -= 1
                return
        self._rehearsing.pop(thread, None)
        self._keys[thread] = key
        if un is None:
            self._denied.discard(thread)
            return
        self._denied.add(thread)
        if way == "ingress" and " " not in action:  # a message; who only declares gets nothing
            who = self._names.get(session, "somebody")
            self._count("denied", f"the certificate of {who} does not allow {action} on {key}")

    def _too_large(
        self, session: str | None, key: str | None, limit: tuple[str, str, int], when: str
    ) -> None:
        kind, keys, most = limit
        names = [
            name
            for known, name in list(self._names.items())
            if session and known.startswith(session)
        ]
        who = names[0] if names else f"session {session}" if session else "somebody"
        self._count(
            "too-large",
            f"a {kind} from {who} on {key or keys} was dropped{when}: it has more than {most} bytes",
        )

    def _remember(self, session: str, name: str) -> None:
        if len(self._names) >= NAMES_MAX:
            self._names.clear()
        self._names[session] = name

    def _count(self, reason: str, what: str) -> None:
        self.counts[reason] += 1
        now = time.monotonic()
        if now - self._said.get(reason, -SAY_SECONDS) >= SAY_SECONDS:
            self._said[reason] = now
            log.warning("%s (%d so far)", what, self.counts[reason])


def _when(line: str) -> str:
    stamp = _STAMP.match(line)
    return f" at {stamp[1]}Z" if stamp is not None else ""


refusals = Refusals()


@contextlib.contextmanager
def standard_output_heard() -> Iterator[None]:
    """While the block runs, what is written to the file descriptor of standard output goes to
    `refusals`.
    """
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
    begins = True
    with os.fdopen(reading, "rb") as lines:
        while piece := lines.readline(LINE_BYTES_MAX):
            if begins and (_RECEIVED not in piece or _TOO_LARGE in piece):
                refusals.hear(piece.decode("utf-8", "replace"))
            begins = piece.endswith(b"\n")
