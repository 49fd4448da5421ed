"""Every file, module and function that the documents and docstrings name is where they say."""

import ast
import importlib
import itertools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "lerobot_act_chunking"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
MODULES = sorted(PACKAGE.rglob("*.py"))
FOLDERS = {path.name for path in PACKAGE.iterdir() if path.is_dir()}

PATH = re.compile(r"[\w.-]+(?:/[\w.*<>-]+)*/?")
OF_THE_PROJECT = FOLDERS | {"benchmarks", "configs", "docs", "examples", "tests", ".ci", PACKAGE.name}
ENDINGS = (".py", ".md", ".yaml", ".png")
DOTTED = re.compile(r"[a-z_]\w*(?:\.\w+)+")


def quoted(text):
    """What stands in single backticks, outside blocks of code."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    return re.findall(r"(?<!`)`([^`\n]+)`(?!`)", prose)


def named_paths(text):
    for name in quoted(text):
        inside = "/" in name and name.split("/", 1)[0] in OF_THE_PROJECT
        if PATH.fullmatch(name) and (inside or name.endswith(ENDINGS[:2])) and "<" not in name:
            yield name


def exists(name, beside):
    places = (ROOT, PACKAGE, beside)
    return any(any(place.glob(name)) if "*" in name else (place / name).exists() for place in places)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_paths_that_pages_name_exist(page):
    named = [name for name in named_paths(page.read_text()) if not name.startswith("outputs")]
    assert [name for name in named if not exists(name, page.parent)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    text = page.read_text()
    for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
        path, _, heading = target.partition("#")
        linked = page if not path else page.parent / path
        assert linked.exists(), target
        if heading:
            titles = re.findall(r"^#+ (.+)$", linked.read_text(), flags=re.M)
            assert heading in {re.sub(r"[^\w -]", "", each.lower()).replace(" ", "-") for each in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_heading_stands_alone(page):
    lines = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S).splitlines()
    glued = [line for before, line in itertools.pairwise(lines) if line.startswith("#") and before]
    assert glued == []


def docstrings(module):
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, kinds):
            yield ast.get_docstring(node) or ""


def resolves(dotted, folder):
    """Whether a name means something, seen from the package or from the folder of who says it."""
    for prefix in (PACKAGE.name, "torch", ".".join(folder.relative_to(ROOT).parts)):
        parts = [*prefix.split("."), *dotted.split(".")]
        for n_modules in range(len(parts), len(prefix.split(".")), -1):
            try:
                found = importlib.import_module(".".join(parts[:n_modules]))
            except ModuleNotFoundError:
                continue
            for name in parts[n_modules:]:
                found = getattr(found, name, None)
            if found is not None:
                return True
    return False


def test_modules_that_docstrings_name_exist():
    found, wrong = 0, []
    for module in MODULES:
        local = FOLDERS | {path.stem for path in module.parent.iterdir()}
        for text in docstrings(module):
            for name in quoted(text):
                if DOTTED.fullmatch(name) and name.split(".")[0] in local and not name.endswith(ENDINGS):
                    found += 1
                    if not resolves(name, module.parent):
                        wrong.append(f"{module.relative_to(ROOT)}: {name}")
    assert wrong == []
    assert found > 5


def test_paths_that_docstrings_name_exist():
    wrong = [
        f"{module.relative_to(ROOT)}: {name}"
        for module in MODULES
        for text in docstrings(module)
        for name in named_paths(text)
        if not exists(name, module.parent)
    ]
    assert wrong == []
