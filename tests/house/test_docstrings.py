"""Everything public has a docstring: modules, classes, functions, methods, properties."""

from __future__ import annotations

import ast

import pytest
from paths import ROOT

PACKAGE = ROOT / "camtopod"
MODULES = sorted(path.relative_to(ROOT).as_posix() for path in PACKAGE.rglob("*.py"))
Documented = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def unsaid(node: ast.Module | Documented, name: str) -> list[str]:
    """Return the names of public objects without a docstring, wherever they are defined."""
    found = [] if ast.get_docstring(node) else [name]
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return found  # what is inside belongs to nobody else
    waiting = list[ast.AST](node.body)
    while waiting:
        one = waiting.pop(0)
        if not isinstance(one, Documented):
            waiting += ast.iter_child_nodes(one)  # behind an `if` or `try`
        elif not one.name.startswith("_"):
            found += unsaid(one, f"{name}:{one.lineno} {one.name}")
    return found


@pytest.mark.parametrize("module", MODULES)
def test_everything_public_has_a_docstring(module: str) -> None:
    assert unsaid(ast.parse((ROOT / module).read_text()), module) == []
