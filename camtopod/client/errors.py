"""Exceptions of the client.

Failures of the bus raise `camtopod.serve.bus.session.BusError`.
"""

from __future__ import annotations

from camtopod.topology import UnknownPlace as UnknownPlace


class NothingLearned(LookupError):
    """No version of the topology has been received yet."""

    def __init__(self) -> None:
        super().__init__(
            "nothing has been learned yet; wait_for(1, seconds) waits for the first version"
        )
