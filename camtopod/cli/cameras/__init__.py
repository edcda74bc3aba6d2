"""Supervision of camera processes: `camtopod grab` runs one process per camera.

Read `supervisor` first (all cameras of a configuration), then `camera_process` (start, watchdog and
restart of one process), `heartbeat` (the pipe between the two), `status_reporter` (status of
cameras whose process cannot publish it) and `daemon_reach` (log lines about a lost daemon). `probe`
opens cameras once, for `camtopod init` and `check --probe`. `decision_words` says why a track
became an event or not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.cli.cameras.camera_process import with_restarts
    from camtopod.cli.cameras.decision_words import clock_words, decision_line, words_of
    from camtopod.cli.cameras.heartbeat import HeartbeatSender
    from camtopod.cli.cameras.probe import check_site, probe_all
    from camtopod.cli.cameras.supervisor import supervise

__all__ = [
    "HeartbeatSender",
    "check_site",
    "clock_words",
    "decision_line",
    "probe_all",
    "supervise",
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
        "probe_all": "probe",
        "with_restarts": "camera_process",
        "supervise": "supervisor",
    },
)
