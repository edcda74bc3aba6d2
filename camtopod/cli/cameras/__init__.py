"""Supervision of camera processes: `camtopod grab` runs one process per camera.

Read `supervisor` first (all cameras of a configuration), then `camera_process` (start, watchdog and
restart of one process), `heartbeat` (the pipe between the two), `status_reporter` (status of
cameras whose process cannot publish it) and `daemon_reach` (log lines about a lost daemon). `probe`
opens cameras once, for `camtopod init` and `check --probe`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.cli.cameras.camera_process import with_restarts
    from camtopod.cli.cameras.heartbeat import HeartbeatSender
    from camtopod.cli.cameras.probe import check_site, probe_all
    from camtopod.cli.cameras.supervisor import supervise

__all__ = [
    "HeartbeatSender",
    "check_site",
    "probe_all",
    "supervise",
    "with_restarts",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "HeartbeatSender": "heartbeat",
        "check_site": "probe",
        "probe_all": "probe",
        "with_restarts": "camera_process",
        "supervise": "supervisor",
    },
)
