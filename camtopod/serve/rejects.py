"""What did not fit: counted by reason, quoted once per reason, never in the way."""

from __future__ import annotations

import logging
from collections import Counter

from camtopod.redact import redact

log = logging.getLogger(__name__)

QUOTE_CHARACTERS_MAX = 120
REASONS_MAX = 100
"""Further reasons are counted together as ``other``."""


class Rejects:
    """Counts by reason. Quotes the first of each reason in the log. Thread-safe enough for one writer."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def add(self, reason: str, where: str, detail: str, raw: bytes | str = b"") -> None:
        """One thing that did not fit: ``where`` it came from, why, and the thing itself."""
        if reason not in self.counts and len(self.counts) >= REASONS_MAX:
            reason = "other"
        self.counts[reason] += 1
        if self.counts[reason] == 1:
            text = raw if isinstance(raw, str) else raw[: 4 * QUOTE_CHARACTERS_MAX].decode("utf-8", "replace")
            quoted = redact(text)[:QUOTE_CHARACTERS_MAX]
            log.warning(
                "rejected (%s) %s: %s: %r; further ones are only counted",
                reason,
                where,
                redact(detail),
                quoted,
            )

    def __bool__(self) -> bool:
        return bool(self.counts)

    def summary(self) -> str:
        """For example ``3 rejected: 2 bad-value, 1 malformed``."""
        parts = ", ".join(f"{count} {reason}" for reason, count in sorted(self.counts.items()))
        return f"{self.counts.total()} rejected: {parts}"
