"""outbox"""

from __future__ import annotations

from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import SpoolBatch, open_spool, spool_path

__all__ = [
    "Publisher",
    "SpoolBatch",
    "open_spool",
    "spool_path",
]
