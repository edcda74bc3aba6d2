"""Supervision of camera processes: `camtopod grab` runs one process per camera.

Read `supervisor` first (all cameras of a configuration), then `camera_process` (start, watchdog and
restart of one process), `heartbeat` (the pipe between the two) and `status_reporter` (status of
cameras whose process cannot publish it). `probe`
opens cameras once, for `camtopod init` and `check --probe`; `onvif` and `finding` find
cameras and their streams for `init`, `naming` gives them ids. `decision_words` says why a track
became an event or not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.cli.cameras.camera_process import with_restarts
    from camtopod.cli.cameras.decision_words import clock_words, decision_line, words_of
    from camtopod.cli.cameras.finding import smaller_streams, streams_by_onvif, streams_by_path
    from camtopod.cli.cameras.heartbeat import HeartbeatSender
    from camtopod.cli.cameras.naming import named_sources, with_names
    from camtopod.cli.cameras.probe import check_site, probe_all
    from camtopod.cli.cameras.supervisor import supervise

__all__ = [
    "HeartbeatSender",
    "check_site",
    "clock_words",
    "decision_line",
    "named_sources",
    "probe_all",
    "smaller_streams",
    "streams_by_onvif",
    "streams_by_path",
    "supervise",
    "with_names",
    "with_restarts",
    "words_of",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "HeartbeatSender": "heartbeat",
        "check_site": "probe",
        "clock_words": "decision_words",
        "decision_line": "decision_words",
        "words_of": "decision_words",
        "named_sources": "naming",
        "probe_all": "probe",
        "smaller_streams": "finding",
        "streams_by_onvif": "finding",
        "streams_by_path": "finding",
        "with_names": "naming",
        "with_restarts": "camera_process",
        "supervise": "supervisor",
    },
)
