"""source"""

from __future__ import annotations

from camtopod.vision.source import ffmpeg_log
from camtopod.vision.source.ffmpeg_log import Complaints
from camtopod.vision.source.live import LiveSource
from camtopod.vision.source.probe import LOOK_SECONDS, Probe, Question, decoders
from camtopod.vision.source.recorded import RecordedSource
from camtopod.vision.source.source_url import AGAIN, kind_of, percent_encoded

__all__ = [
    "AGAIN",
    "LOOK_SECONDS",
    "Complaints",
    "LiveSource",
    "Probe",
    "Question",
    "RecordedSource",
    "decoders",
    "ffmpeg_log",
    "kind_of",
    "percent_encoded",
]
