"""The package as it is released: versions and tags, the wheel, pinned packages, examples, what a forge shows."""

from __future__ import annotations

import doctest
import inspect
import re
import subprocess
import sys
import tomllib
import zipfile
from itertools import chain
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from pages import links
from paths import DEPLOY, ROOT

import camtopod
from camtopod.adapt import tracks
from camtopod.learn import settings

WHEEL_BYTES_MAX = 1_500_000
IMPORT_SECONDS_MAX = 0.35
"""Processor time of Python with `import camtopod`, which loads no package of others."""
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
RELEASES = re.findall(r"^## (\S+)$", (DEPLOY / "changelog.md").read_text(), re.MULTILINE)
"""Newest first; the heading of what is not released has a second word."""


def test_all_say_the_same_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"]
    add_on = yaml.safe_load((DEPLOY / "home-assistant" / "config.yaml").read_text())["version"]

    assert {PROJECT["version"], citation, add_on, RELEASES[0]} == {camtopod.__version__}


def test_every_release_has_its_tag() -> None:
    """The newest gets it after its commit, and a checkout may be without tags."""
    command = ["git", "-C", str(ROOT), "tag", "--list", "v*"]
    tags = {*subprocess.run(command, capture_output=True, text=True).stdout.split()}
    versions = [f"v{release}" for release in RELEASES]

    assert not tags or {*versions[1:]} <= tags <= {*versions}


def test_the_wheel_is_small_and_has_all_files(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    [wheel] = tmp_path.iterdir()

    assert wheel.stat().st_size <= WHEEL_BYTES_MAX
    files = [path for path in (ROOT / "camtopod").rglob("*") if path.is_file()]
    package = {str(path.relative_to(ROOT)) for path in files if path.suffix != ".pyc"}
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert names == package


def test_the_import_is_quick() -> None:
    """The least of five runs is compared, as other programs on the processor delay some."""
    code = "import time, camtopod; print(time.process_time())"
    seconds = [float(subprocess.check_output([sys.executable, "-c", code])) for _ in range(5)]

    assert min(seconds) <= IMPORT_SECONDS_MAX


def test_ci_pins_every_package_to_a_version_that_is_allowed() -> None:
    lines = (ROOT / ".ci" / "constraints.txt").read_text().splitlines()
    pins = {canonicalize_name(name): version for name, version in (p.split("==") for p in lines)}
    extras = PROJECT["optional-dependencies"].values()

    for requirement in map(Requirement, chain(PROJECT["dependencies"], *extras)):
        if requirement.name != "camtopod":
            assert pins[canonicalize_name(requirement.name)] in requirement.specifier


def test_every_example_of_a_docstring_is_run() -> None:
    """Those of what `import camtopod` offers run in `test_front_door`."""
    paths = [*(ROOT / "camtopod").rglob("*.py")]
    files = {str(p) for p in paths if re.search(r"^ +>>> ", p.read_text(), re.MULTILINE)}
    front = {inspect.getfile(getattr(camtopod, name)) for name in camtopod.__all__}
    modules = (tracks, settings)

    assert files <= front | {inspect.getfile(module) for module in modules}
    assert [bool(doctest.testmod(module).failed) for module in modules] == [False, False]


@pytest.mark.parametrize("page", [*(ROOT / ".github").rglob("*.md")], ids=lambda page: page.name)
def test_links_of_the_forges_pages_lead_to_files(page: Path) -> None:
    assert all((page.parent / target).exists() for target in links(page.read_text()))
