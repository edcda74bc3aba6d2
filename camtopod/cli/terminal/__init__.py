"""Terminal output: the progress line of long commands, and what `camtopod watch` shows in words."""

from __future__ import annotations

from camtopod.cli.terminal.progress import Progress as Progress
from camtopod.cli.terminal.site_state import LINKS_SHOWN as LINKS_SHOWN
from camtopod.cli.terminal.site_state import SiteState as SiteState
from camtopod.cli.terminal.site_state import alarm_lines as alarm_lines
from camtopod.cli.terminal.site_state import busiest_links as busiest_links
from camtopod.cli.terminal.site_state import prediction_line as prediction_line
from camtopod.cli.terminal.site_state import topology_lines as topology_lines
from camtopod.cli.terminal.site_state import transit as transit

__all__ = [
    "LINKS_SHOWN",
    "Progress",
    "SiteState",
    "alarm_lines",
    "busiest_links",
    "prediction_line",
    "topology_lines",
    "transit",
]
