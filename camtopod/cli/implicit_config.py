"""The configuration file that is read without --config."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

PLACES = (Path("camtopod.toml"), Path("/etc/camtopod/camtopod.toml"))
"""Files that are read without --config; the first one that exists."""
NONE = "none"
"""Value of --config for no configuration at all."""
_NEED_IT = ("run", "grab", "ingest", "keys", "check", "doctor")
"""Commands that stop if the file that was found cannot be used.

They publish, learn or make certificates for a site, which the file may name, or check the file.
"""


def find(args: argparse.Namespace) -> None:
    """Replace ``args.config``, the text of --config, with a path or None.

    ``args.config_found`` is True if the path was not given but found.
    """
    args.config_found = False
    if args.config == NONE:
        args.config = None
    elif args.config is not None:
        args.config = Path(args.config)
    else:
        args.config = next(filter(_exists, PLACES), None)
        args.config_found = args.config is not None


def may_skip(args: argparse.Namespace) -> bool:
    """Return True if the command goes on without ``args.config`` should that not be usable."""
    return getattr(args, "config_found", False) and args.command not in _NEED_IT


def shown(path: Path) -> str:
    """Return the path of a file that was found as messages show it, with its directory."""
    return str(path) if path.is_absolute() else f"./{path}"


def _exists(path: Path) -> bool:
    """Return True if there is such a file, or if that cannot be known."""
    try:
        os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError:  # reading it will give the reason
        return True
    return True
