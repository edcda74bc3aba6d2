"""The programs that publish a camera: detect two at the same time, and none for long.

A camera has one publisher at a time, and each start of it has a boot id of its own. Two boot ids
that take turns mean two boxes with one camera id, whose views would be learned as one.
"""

from __future__ import annotations

from msgspec import Struct

RETURNS_MIN = 3
"""Number of turns in a row that two boots take until they count as two publishers.

Fewer are normal after a restart: the last events of the old boot may arrive after the first of the
new one.
"""


class CameraBoots(Struct):
    """The boot ids that have published a camera.

    boot: boot of the newest event.
    before: the boot before that.
    returns: how often these two have taken turns in a row.
    """

    boot: str
    before: str = ""
    returns: int = 0

    def note_boot(self, boot: str) -> bool:
        """Note the boot of one more event; return True if two programs publish at the same time."""
        if boot == self.boot:
            return False
        self.returns = self.returns + 1 if boot == self.before else 0
        self.before = self.boot
        self.boot = boot
        return self.returns >= RETURNS_MIN
