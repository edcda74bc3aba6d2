"""Terminal output: progress lines, the live view of `camtopod watch`, and safe standard streams.

`site_state` collects what `watch` shows and puts it into words, `screen` draws it with rich,
`progress` writes the progress line of long commands, and `standard_streams` keeps a slow reader of
the log from blocking a daemon.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.cli.terminal.progress import Progress
    from camtopod.cli.terminal.screen import show
    from camtopod.cli.terminal.site_state import (
        SiteState,
        SiteView,
        alarm_line,
        busiest_links,
        daemon_line,
        newest_alarms,
        prediction_line,
        topology_lines,
        transit,
    )

__all__ = [
    "Progress",
    "SiteState",
    "SiteView",
    "alarm_line",
    "busiest_links",
    "daemon_line",
    "newest_alarms",
    "prediction_line",
    "show",
    "standard_streams",
    "topology_lines",
    "transit",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "SiteState": "site_state",
        "Progress": "progress",
        "SiteView": "site_state",
        "alarm_line": "site_state",
        "busiest_links": "site_state",
        "daemon_line": "site_state",
        "newest_alarms": "site_state",
        "prediction_line": "site_state",
        "show": "screen",
        "topology_lines": "site_state",
        "transit": "site_state",
    },
)
