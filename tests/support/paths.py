"""Folders of the checkout."""

from __future__ import annotations

from pathlib import Path

TESTS = Path(__file__).parent.parent
ROOT = TESTS.parent
DEPLOY = ROOT / "deploy"
EXAMPLES = TESTS / "examples"
SUPPORT = TESTS / "support"
