"""Whether the cameras of a box reach the daemon, said once for all of them: each has a connection
of its own, and they are lost and made again at different moments.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping

log = logging.getLogger(__name__)

SETTLE_SECONDS = 1.0
"""What holds for all cameras is said when it has held for this long."""
PARTIAL_SECONDS = 15.0
"""The same where only some are concerned; connections come back within a few seconds of each
other.
"""
NAMED_MAX = 10
_ALL = frozenset({"*"})


class Reach:
    """Time is an argument, in seconds of a clock that never steps."""

    def __init__(self) -> None:
        self._now: frozenset[str] = frozenset()
        """The cameras that do not reach the daemon, or `_ALL`."""
        self._since = 0.0
        self._said: frozenset[str] = frozenset()

    def tell(self, known: Mapping[str, str], now: float) -> None:
        """``known``: why a camera does not reach the daemon, "" if it does; of those of which it is
        known.
        """
        away = {camera: why for camera, why in known.items() if why}
        if not known:
            return
        found = _ALL if len(away) == len(known) else frozenset(away)
        if found != self._now:
            self._now, self._since = found, now
        partial = found not in (_ALL, frozenset())
        if found == self._said or now - self._since < (
            PARTIAL_SECONDS if partial else SETTLE_SECONDS
        ):
            return

        self._said = found
        if not away:
            log.info("the daemon is reached again")
        elif not partial:
            log.warning("%s; events wait in the spools of all cameras", next(iter(away.values())))
        else:
            names = ", ".join(sorted(away)[:NAMED_MAX]) + (
                " and others" if len(away) > NAMED_MAX else ""
            )
            log.warning(
                "%s of %d cameras do not reach the daemon: %s (%s)",
                len(away),
                len(known),
                names,
                next(iter(away.values())),
            )
