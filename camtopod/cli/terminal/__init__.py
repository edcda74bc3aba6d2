"""Terminal output: `progress` of long commands; `site_state`, which `camtopod watch` shows."""

from camtopod.cli.terminal.progress import ProgressLine as ProgressLine
from camtopod.cli.terminal.site_state import (
    LINKS_SHOWN as LINKS_SHOWN,
    SiteState as SiteState,
    alarm_lines as alarm_lines,
    busiest_links as busiest_links,
    topology_lines as topology_lines,
    transit as transit,
)
