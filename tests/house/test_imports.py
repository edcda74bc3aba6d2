"""Imports go one way: the nouns, then what computes, then what can fail, then the commands."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest
from paths import ROOT

PACKAGE = ROOT / "camtopod"
MODULES = sorted(path.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py"))
PURE = {"numpy", "scipy", "msgspec"}
NOUNS = {"camtopod.records", "camtopod.codec", "camtopod.soundness"}


def imports(source: str) -> set[str]:
    """Every module a source text imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            module = node.module or ""
            found.add(module)
            if module == "camtopod":
                found |= {f"camtopod.{alias.name}" for alias in node.names}
    return found


def problems(module: str, source: str) -> list[str]:
    """What is wrong with the imports of ``module`` (a path below the package)."""
    found = imports(source)
    ours = {name for name in found if name.startswith("camtopod.")}
    packages = {name.split(".")[0] for name in found}
    folder = module.split("/")[0] if "/" in module else ""
    wrong = []
    if module in ("records.py", "codec.py", "soundness.py"):
        wrong += sorted(ours - NOUNS)
    if folder == "learn":
        wrong += sorted(name for name in ours if name not in NOUNS and not name.startswith("camtopod.learn"))
        wrong += sorted(packages & {"logging", "threading", "socket", "time", "random", "sqlite3", "zenoh", "cv2"})
    if folder == "districts":
        wrong += sorted(
            name for name in ours if name not in NOUNS and not name.startswith(("camtopod.districts", "camtopod.learn"))
        )
        wrong += sorted(packages & {"logging", "threading", "socket", "time", "random"})
    if folder == "adapt":
        wrong += sorted(name for name in ours if name not in NOUNS and not name.startswith("camtopod.adapt"))
        wrong += sorted(packages & {"logging", "threading", "socket", "time", "random"})
    if folder == "vision":
        wrong += sorted(
            name for name in ours if name not in NOUNS | {"camtopod.redact"} and not name.startswith("camtopod.vision")
        )
    if folder in ("serve", "sim", "export", "client", "web") or module == "config.py":
        wrong += sorted(name for name in ours if f"{name}.".startswith("camtopod.cli."))
    if "zenoh" in packages and module != "serve/bus.py":
        wrong.append("zenoh")
    if "paho" in packages and module != "serve/mqtt.py":
        wrong.append("paho")
    if "prometheus_client" in packages and module != "serve/metrics.py":
        wrong.append("prometheus_client")
    if packages & {"starlette", "uvicorn"} and module != "web/app.py":
        wrong.append("starlette")
    if "rich" in packages and module != "cli/screen.py":
        wrong.append("rich")
    if "cv2" in packages and folder not in ("vision", "sim", "export"):
        wrong.append("cv2")
    if "sqlite3" in packages and folder != "serve":
        wrong.append("sqlite3")
    return wrong


def wall_clock_reads(source: str) -> list[int]:
    """Lines that read the wall clock."""
    lines = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            name = f"{node.value.id}.{node.attr}"
            if name in ("time.time", "time.time_ns", "datetime.now", "datetime.utcnow", "date.today"):
                lines.append(node.lineno)
        if isinstance(node, ast.ImportFrom) and node.module == "time":
            lines += [node.lineno for alias in node.names if alias.name in ("time", "time_ns")]
    return lines


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_one_way(module: str) -> None:
    source = (ROOT / module).read_text(encoding="utf-8")
    assert problems(module, source) == []
    if module != "serve/clock.py":
        assert wall_clock_reads(source) == []


def test_the_guard_sees_a_wrong_import() -> None:
    assert problems("learn/x.py", "import zenoh\nfrom camtopod.serve import bus") == [
        "camtopod.serve", "zenoh", "zenoh",
    ]  # fmt: skip
    assert problems("records.py", "from camtopod import config") == ["camtopod.config.settings"]
    assert problems("districts/x.py", "import time\nfrom camtopod.serve import bus") == ["camtopod.serve", "time"]
    assert problems("learn/x.py", "from camtopod.districts import line") == ["camtopod.districts"]
    assert problems("vision/x.py", "def f():\n    from camtopod.learn import settings") != []
    assert problems("serve/x.py", "import camtopod.cli.main") == ["camtopod.cli.main"]
    assert problems("web/x.py", "import uvicorn, camtopod.cli.exits") == ["camtopod.cli.exits", "starlette"]
    assert problems("client/x.py", "from camtopod.client import view") == []
    assert problems("cli/x.py", "from paho.mqtt import client\nfrom rich import print") == ["paho", "rich"]
    assert problems("serve/x.py", "import prometheus_client") == ["prometheus_client"]
    assert problems("adapt/x.py", "import time\nfrom camtopod.serve import mqtt") == ["camtopod.serve", "time"]
    assert wall_clock_reads("import time\nnow = time.time()") == [2]
    assert wall_clock_reads("from time import time") == [1]


def test_every_module_is_seen() -> None:
    assert {"records.py", "learn/learner.py", "serve/bus.py", "vision/grabber.py"} <= set(MODULES)


@pytest.mark.parametrize("module", ["camtopod.predict.predictor", "camtopod.client", "camtopod.serve.daemon"])
def test_who_only_predicts_does_not_load_what_learning_needs(module: str) -> None:
    """SciPy takes 50 MB and most of a second; the daemon's own process and every tracker would have it."""
    code = f"import sys, {module}; sys.exit(any(name.split('.')[0] == 'scipy' for name in sys.modules))"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
