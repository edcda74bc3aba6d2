"""Variables are nouns, a class name means one thing, and no function has many parameters."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator

import pytest
from paths import ROOT

PRONOUNS = """
    all another any anybody anyone anything both each either every everybody everyone everything
    few fewer here hers his how it its less many mine more most much neither nobody none nothing
    one ones other others ours own rest same several some somebody someone something such that
    theirs them there these they this those what whatever when where which who whoever whom whose
    why yours
"""
PARTICIPLES = """
    accepted added adding adjusted agreed agreeing aligned allowed analysed answered appeared
    arrived asked associated awaited balanced began begun called came cancelled captured centred
    changed checked chosen claimed closed come competing confined contradicted
    contributed converted copied corrected counted covered created damaged declared decoded
    delayed departed described differed differing discarded done doubled doubted drawn dropped
    emptied encoded ended entered entering existing exited explained exported exposed faded
    failed fetched filled fitted followed following forgotten forked found framed gained given
    gone got grabbed greeted grouped guarded had handed happened heard held hidden hung
    identified ignored incoming issued joined judged judging kept known lacking learned leaving
    left linked listed listening lived loaded logged looked lost made matched meant measured
    merged missed missing mixed moved moving named needed nested numbered occluded occupied
    offered opened ordered outgoing overlapped overlapping packed padded passed passing paused
    piped placed predicted prepared published put quoted ran ranked reached read received
    recorded recovered refused rejected related relearned released remaining remembered removed
    renamed renumbered replaced reported required rescued reserved restarted retained retired
    returned revoked running said scaled scheduled seen sent settled shared shown skipped
    smoothed sought spent spooled squared stamped started stated stayed stored stuck taken
    tested tied timed told tracked trusted unanswered unchanged unclaimed uncut undecoded
    unexplained unmatched unmet unplaced unrelated unseen untied untimed untracked untrusted
    used vanished waited waiting walked wanted watched watching weighed woken written
"""
WORDS = frozenset((PRONOUNS + PARTICIPLES).split())
"""Words that say nothing of what a variable holds. Counts that are *expected* and *observed* are
terms of statistics, and a *split* is a noun.
"""
PICTURE_SIDES = {"right", "top", "bottom"}
"""In a scope that has one of these, `left` is a side, too."""
PER_THOUSAND_MAX = {"camtopod": 2, "bench": 1}
"""Variables of `WORDS` in a thousand statements of each package."""
SCOPES = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


def sources(package: str = "camtopod") -> Iterator[tuple[str, ast.Module]]:
    """Yield the path in the package and the syntax tree of each module."""
    for path in sorted((ROOT / package).rglob("*.py")):
        yield path.relative_to(ROOT / package).as_posix(), ast.parse(path.read_text("utf-8"))


def is_wire(node: ast.ClassDef) -> bool:
    """Return whether a class is a record, whose fields have the names that are sent or stored."""
    return any("Struct" in ast.unparse(base) for base in node.bases)


def names_in(scope: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield name and line of each variable that a scope binds, without the scopes in it."""
    fields = isinstance(scope, ast.ClassDef) and is_wire(scope)
    stack = list(ast.iter_child_nodes(scope))
    while stack:
        node = stack.pop()
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and not fields:
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name:
            yield node.name, node.lineno
        elif (
            isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Store)
            and isinstance(node.value, ast.Name)
            and node.value.id == "self"
        ):
            yield node.attr, node.lineno
        if not isinstance(node, SCOPES):
            stack.extend(ast.iter_child_nodes(node))


def fields_of(tree: ast.AST) -> set[str]:
    """Return the fields of the records in a tree: they are set by their names on `self`, too."""
    return {
        field.target.id
        for record in ast.walk(tree)
        if isinstance(record, ast.ClassDef) and is_wire(record)
        for field in record.body
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
    }


def idle_names(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Yield name and line of each variable of a module that is named by one of `WORDS`."""
    fields = fields_of(tree)
    for scope in ast.walk(tree):
        if isinstance(scope, SCOPES):
            names = list(names_in(scope))
            sides = PICTURE_SIDES & {name for name, _ in names}
            for name, line in names:
                word = name.strip("_")
                if word in WORDS and name not in fields and not (word == "left" and sides):
                    yield name, line


@pytest.mark.parametrize("package", PER_THOUSAND_MAX)
def test_variables_are_nouns(package: str) -> None:
    """Count assigned names, parameters, loop variables and attributes of `self`."""
    statements, idle = 0, []
    for path, tree in sources(package):
        statements += sum(isinstance(node, ast.stmt) for node in ast.walk(tree))
        idle += [f"{path}:{line} {name}" for name, line in idle_names(tree)]
    assert len(idle) <= PER_THOUSAND_MAX[package] * statements / 1000, "\n".join(idle)


TWINS = {name: ["client/aio.py", "client/site.py"] for name in ("Answers", "Site")}
"""Public class names of the client for threads that its twin for asyncio has, too."""


def test_a_class_name_means_one_thing() -> None:
    modules = defaultdict(list)
    for path, tree in sources():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                modules[node.name].append(path)
    twice = {name: paths for name, paths in modules.items() if len(paths) > 1}
    assert twice == TWINS


PARAMETERS_MAX = 8
MANY_PARAMETERS = {
    "serve/ingest/intake.py __init__": "is given all that takes part in a batch",
}
"""Functions with more parameters than `PARAMETERS_MAX`, and why."""


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Return the number of a function's parameters, without `self` and `cls`."""
    args = function.args
    names = [arg.arg for arg in (*args.posonlyargs, *args.args, *args.kwonlyargs)]
    count = len(names) - bool({"self", "cls"} & set(names[:1]))
    return count + (args.vararg is not None) + (args.kwarg is not None)


def test_no_function_has_many_parameters() -> None:
    many = {
        f"{path} {node.name}"
        for path, tree in sources()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and parameters(node) > PARAMETERS_MAX
    }
    assert many == MANY_PARAMETERS.keys()
