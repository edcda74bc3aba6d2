"""ingest"""

from __future__ import annotations

from camtopod.serve.ingest.camera_registry import Received
from camtopod.serve.ingest.puller import Puller
from camtopod.serve.ingest.receiver import Receiver

__all__ = [
    "Puller",
    "Received",
    "Receiver",
]
