"""Imports go one way, and only to the names that packages export; what is public is documented.

`FLOORS` lists the packages from the lowest up: a module imports from its own package and from lower
ones. From outside, a package is used through the names that its head re-exports, or through its
modules if it re-exports none, which is so where some of the modules take long to import.
"""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT

PACKAGE = ROOT / "camtopod"
MODULES = sorted(
    path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    for path in PACKAGE.rglob("*.py")
    if path.parent != PACKAGE or path.name != "__init__.py"
)
PACKAGES = sorted(
    module.removesuffix(".__init__") for module in MODULES if module.endswith(".__init__")
)

FLOORS = (
    "arrays columns event_numbers event_time files labels publishers redact visible",
    "words markov_chain",
    "records",
    "admin mqtt older sound_columns",
    "soundness",
    "codec",
    "untrusted_xml topology",
    "statuses",
    "predict",
    "scoring",
    "learn.settings learn.limits learn.lags",
    "learn.zones",
    "learn.window",
    "learn.traffic",
    "learn.clocks learn.association",
    "learn.links",
    "learn.changes learn.next_camera",
    "learn.paths",
    "learn",
    "adapt export sim",
    "plot",
    "vision.settings vision.boxes",
    "vision.detect",
    "vision.detector",
    "vision.source vision.track",
    "vision",
    "vision.show",
    "config",
    "keys city",
    "serve.runtime",
    "serve.bus serve.storage",
    "serve.outbox",
    "serve.ingest",
    "serve.learner_process",
    "serve",
    "serve.monitoring client web",
    "cli.exits",
    "cli.terminal",
    "cli.common",
    "cli.events cli.generated cli.cameras",
    "cli.city",
    "cli.commands cli.operator",
    "cli",
    "__main__",
)
FLOOR = {f"camtopod.{name}": number for number, line in enumerate(FLOORS) for name in line.split()}
TYPES = {("camtopod.words", "camtopod.records"), ("camtopod.markov_chain", "camtopod.records")}
"""Modules that import a higher one for type checkers alone."""
PURE = ("words", "topology", "predict", "learn", "adapt")
"""Packages without I/O, clocks, threads and randomness of their own: what goes in is all that
matters.
"""
NOT_PURE = {
    *("cv2", "logging", "os", "random", "socket", "sqlite3", "subprocess", "threading", "time"),
    "zenoh",
}
WALL_CLOCKS = ("time.time", "time.time_ns", "datetime.now", "datetime.utcnow", "date.today")
HOMES = {
    "zenoh": ("serve.bus.session",),
    "paho": ("mqtt",),
    "prometheus_client": ("serve.monitoring.metrics",),
    "starlette": ("web.app", "web.api", "web.guards", "web.login"),
    "uvicorn": ("web.app", "web.connections"),
    "matplotlib": ("plot",),
    "rich": ("cli.commands.watch",),
    "pymetis": ("city.partition",),
    "distributed": ("city.cluster", "cli.city.learn_city"),
    "threadpoolctl": ("city.cluster",),
    "onnxruntime": ("vision.detector.engines",),
    "cv2": ("vision", "sim", "export"),
    "sqlite3": (
        *("serve.storage", "serve.outbox", "serve.daemon", "serve.versions"),
        "cli.events.time_order",
    ),
}
"""Other people's packages, and the modules or packages that may know them."""


def imports(source: str) -> list[tuple[str, str | None]]:
    """Return every (module, name) that a source text imports; plain ``import`` has no name."""
    found: list[tuple[str, str | None]] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            found += [(node.module or "", alias.name) for alias in node.names]
    return found


def below(name: str, package: str) -> bool:
    """Return True if a module is a package, or lies in it."""
    return f"{name}.".startswith(f"{package}.")


def floor_of(module: str) -> int:
    """Return the floor of a module's nearest listed package."""
    while module not in FLOOR:
        module, _, rest = module.rpartition(".")
        assert module, f"no floor for {rest}"
    return FLOOR[module]


def package_of(module: str) -> str:
    """Return the package that a module lies in."""
    module = module.removesuffix(".__init__")
    return module if module in PACKAGES else module.rpartition(".")[0]


def door_of(module: str) -> list[str]:
    """Return the names that a package's head defines or re-exports.

    A name is re-exported by ``from package.module import Name as Name``.
    """
    head = importlib.import_module(module)
    names = []
    for node in ast.parse(Path(str(head.__file__)).read_text("utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            names += [alias.name for alias in node.names if alias.asname == alias.name]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.append(node.target.id)
    return names


def problems(module: str, source: str) -> list[str]:
    """Return the forbidden imports of ``module`` (its dotted name)."""
    wrong = []
    here = package_of(module)
    is_pure = any(below(module, f"camtopod.{package}") for package in PURE)
    for target, name in imports(source):
        root = target.partition(".")[0]
        if root in HOMES and not any(below(module, f"camtopod.{home}") for home in HOMES[root]):
            wrong.append(target)
        if is_pure and root in NOT_PURE:
            wrong.append(target)
        if not below(target, "camtopod"):
            continue
        if target == "camtopod":
            target, name = f"camtopod.{name}", None
        if target == "camtopod.__version__":
            continue
        from_submodule = f"{target}.{name}" in MODULES or f"{target}.{name}" in PACKAGES
        used = f"{target}.{name}" if from_submodule and f"{target}.{name}" in FLOOR else target
        inside = package_of(target) == here or below(here, package_of(target))
        is_own = inside and package_of(target) != "camtopod"
        if not is_own and floor_of(used) >= floor_of(module) and (module, used) not in TYPES:
            wrong.append(f"{used} is not below")
        if inside or (target not in PACKAGES and target.count(".") == 1):
            continue
        if not door_of(package_of(target)):
            continue
        if target not in PACKAGES:
            wrong.append(f"{target} is behind the door of {package_of(target)}")
        elif name and name not in door_of(target):
            wrong.append(f"{name} is not in the door of {target}")
    return wrong


def wall_clock_reads(source: str) -> list[int]:
    """Return the lines that read the wall clock."""
    lines = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            name = f"{node.value.id}.{node.attr}"
            if name in WALL_CLOCKS:
                lines.append(node.lineno)
        if isinstance(node, ast.ImportFrom) and node.module == "time":
            lines += [node.lineno for alias in node.names if alias.name in ("time", "time_ns")]
    return lines


def test_imports_go_one_way_and_through_doors() -> None:
    for module in MODULES:
        source = (ROOT / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")
        assert problems(module, source) == [], module
        if module != "camtopod.serve.runtime.clock":
            assert wall_clock_reads(source) == [], module


@pytest.mark.parametrize(
    ("module", "source", "wrong"),
    [
        ("learn.x", "import zenoh", ["zenoh", "zenoh"]),
        ("records", "from camtopod import config", ["camtopod.config is not below"]),
        ("records.x", "from camtopod.codec import x", ["camtopod.codec is not below"]),
        (
            "web.x",
            "from camtopod.learn.links.transit_time import peak",
            ["camtopod.learn.links.transit_time is behind the door of camtopod.learn.links"],
        ),
        (
            "web.x",
            "from camtopod.learn.links import no_such",
            ["no_such is not in the door of camtopod.learn.links"],
        ),
        ("web.x", "from camtopod.learn.links import LinkTable", []),
    ],
)
def test_the_guard_sees_a_wrong_import(module: str, source: str, wrong: list[str]) -> None:
    assert problems(f"camtopod.{module}", source) == wrong


def test_the_guard_sees_the_wall_clock() -> None:
    assert wall_clock_reads("import time\nnow = time.time()") == [2]
    assert wall_clock_reads("from time import time") == [1]


def test_a_package_is_small_and_has_a_door() -> None:
    for package in PACKAGES:
        folder = ROOT / package.replace(".", "/")
        door = importlib.import_module(package)
        assert len(list(folder.glob("*.py"))) <= 21, package
        assert door.__doc__, package
        assert [name for name in door_of(package) if not hasattr(door, name)] == [], package


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


def test_everything_public_has_a_docstring() -> None:
    for path in PACKAGE.rglob("*.py"):
        assert unsaid(ast.parse(path.read_text()), str(path)) == []


@pytest.mark.parametrize(
    "module",
    [
        "camtopod.predict",
        "camtopod.client",
        "camtopod.serve.daemon",
        "camtopod.cli.commands.predict",
    ],
)
def test_programs_that_only_predict_do_not_load_scipy(module: str) -> None:
    """SciPy takes 50 MB and most of a second, in the daemon's own process and in every tracker."""
    code = f"import sys, {module}; sys.exit(any(name.split('.')[0] == 'scipy' for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0
