"""The generator of deploy/, for tests: it is a script and not part of the package."""

from __future__ import annotations

import importlib.util
from types import ModuleType

from paths import DEPLOY


def generator() -> ModuleType:
    """The module ``deploy/generate.py``."""
    spec = importlib.util.spec_from_file_location("generate", DEPLOY / "generate.py")
    assert spec is not None and spec.loader is not None  # noqa: PT018
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
