"""Compare configurations: which changed settings a running daemon can adopt without a restart."""

from __future__ import annotations

from operator import attrgetter

import msgspec

from camtopod.config import TABLES, Config, Limits

WHILE_RUNNING = ("commit_seconds", "status_seconds")
"""Settings of [limits] that are read at every use, so that a change takes effect at once."""
_OF_OTHERS = ("vision",)
"""Tables that the daemon does not read. ([cameras] is not in `TABLES` at all.)"""


def changed_settings(old: Config, new: Config) -> tuple[Limits, list[str]]:
    """Return the new limits to use from now on, and the changed settings that need a restart."""
    obeyed = {name: getattr(new.limits, name) for name in WHILE_RUNNING}
    waiting = []
    for table in TABLES:
        before, after = attrgetter(table)(old), attrgetter(table)(new)
        for name in after.__struct_fields__:
            title = f"{table}.{name}"
            if (
                getattr(before, name) == getattr(after, name)
                or table in _OF_OTHERS
                or title in TABLES
            ):
                continue
            if table != "limits" or name not in obeyed:
                waiting.append(title)
    return msgspec.structs.replace(old.limits, **obeyed), waiting
