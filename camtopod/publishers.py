"""Who publishes a camera: one program at a time, each start of it with a boot of its own. Two that
take turns are two boxes with one camera id, whose views are learned as if they were one.
"""

from __future__ import annotations

from msgspec import Struct

RETURNS_MIN = 3
"""So often in a row two boots have to take turns: the last events of one that ended may come after
the first of the next."""


class Publisher(Struct):
    """Whose event came last (``boot``), whose before that, and how often these two have taken turns
    since.
    """

    boot: str
    before: str = ""
    returns: int = 0

    def note(self, boot: str) -> bool:
        """One more event; True if it shows that two publish at the same time."""
        if boot == self.boot:
            return False
        self.returns = self.returns + 1 if boot == self.before else 0
        self.before, self.boot = self.boot, boot
        return self.returns >= RETURNS_MIN
