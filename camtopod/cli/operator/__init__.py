"""Commands by which an operator changes a site by hand: `forget`, `rename`, `reset`.

Each is a module like those of `camtopod.cli.commands`. `carry_out` passes the command to the daemon
or, if none runs, stores it in the state directory.
"""

from __future__ import annotations

__all__: list[str] = []
