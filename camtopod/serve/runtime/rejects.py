"""What did not fit: counted by reason, quoted once per reason, a few of each kept, never in the
way.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter, deque

from camtopod.redact import redact

log = logging.getLogger(__name__)

QUOTE_CHARACTERS_MAX = 120
REASONS_MAX = 100
"""Further reasons are counted together as ``other``."""
SAMPLES_MAX = 3
"""The newest of each reason are kept."""


class Rejects:
    """Counts by reason. Quotes the first of each reason in the log. Thread-safe."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self._samples: dict[str, deque[str]] = {}
        self._mutex = threading.Lock()

    def add(self, reason: str, where: str, detail: str, raw: bytes | str = b"") -> None:
        """One thing that did not fit: ``where`` it came from, why, and the thing itself."""
        with self._mutex:
            if reason not in self.counts and len(self.counts) >= REASONS_MAX:
                reason = "other"
            self.counts[reason] += 1
            text = (
                raw
                if isinstance(raw, str)
                else raw[: 4 * QUOTE_CHARACTERS_MAX].decode("utf-8", "replace")
            )
            most = QUOTE_CHARACTERS_MAX
            sample = f"{where[:most]}: {detail[:most]}: {redact(text)[:most]!r}"
            self._samples.setdefault(reason, deque(maxlen=SAMPLES_MAX)).append(sample)
            first = self.counts[reason] == 1
        if first:
            log.warning("rejected (%s) %s; further ones are only counted", reason, redact(sample))

    def samples(self) -> dict[str, list[str]]:
        """The newest of each reason: where, why, what."""
        with self._mutex:
            return {
                reason: [redact(sample) for sample in kept]
                for reason, kept in self._samples.items()
            }

    def __bool__(self) -> bool:
        return bool(self.counts)

    def summary(self) -> str:
        """For example ``3 rejected: 2 bad-value, 1 malformed``."""
        parts = ", ".join(f"{count} {reason}" for reason, count in sorted(self.counts.items()))
        return f"{self.counts.total()} rejected: {parts}"
