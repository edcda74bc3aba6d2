"""Count rejected input by reason, log the first of each reason and keep a few samples."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections import Counter, deque

from camtopod import codec
from camtopod.redact import redact

log = logging.getLogger(__name__)

QUOTE_CHARACTERS_MAX = 120
"""Longest part of a sample that is kept, in characters."""
SAMPLES_MAX = 3
"""Samples kept of each reason, the newest ones."""


class Rejects:
    """Counts of rejected input by reason; logs the first sample of each reason. Thread-safe."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._samples: dict[str, deque[str]] = {}
        self._mutex = threading.Lock()

    def add(self, reason: str, source: str, detail: str, raw: bytes = b"") -> None:
        """Count one rejected input.

        reason: the name it is counted under, one of a few.
        source: where it came from.
        detail: why it was rejected.
        raw: the input itself.
        """
        with self._mutex:
            self.counts[reason] += 1

            # Keep a shortened and redacted sample; MessagePack as text.
            with contextlib.suppress(codec.Rejected, TypeError, ValueError, RecursionError):
                raw = codec.to_json(codec.read(object, raw, pack=True))
            text = raw[: 4 * QUOTE_CHARACTERS_MAX].decode("utf-8", "backslashreplace")
            limit = QUOTE_CHARACTERS_MAX
            sample = f"{source[:limit]}: {detail[:limit]}: {redact(text)[:limit]!r}"
            self._samples.setdefault(reason, deque(maxlen=SAMPLES_MAX)).append(sample)
            first = self.counts[reason] == 1
        # Log outside the lock.
        if first:
            log.warning("rejected (%s) %s; further ones are only counted", reason, redact(sample))

    def samples(self) -> dict[str, list[str]]:
        """Return the newest samples of each reason: where from, why, and the input."""
        with self._mutex:
            return {
                reason: [redact(sample) for sample in samples]
                for reason, samples in self._samples.items()
            }
