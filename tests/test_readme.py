"""README and docs: tables are from the results, Python runs, the site has every page."""

import importlib.util
import json
import re
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import yaml
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

import lerobot_act_chunking as ac

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
DOCS = sorted((ROOT / "docs").rglob("*.md"))
CHECKPOINT = "outputs/train/act/checkpoints/last/pretrained_model"


def load(path: str):
    """A script of the repository as a module."""
    spec = importlib.util.spec_from_file_location(Path(path).stem, ROOT / path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def python_blocks(page: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", page.read_text(), flags=re.M | re.S)


def test_the_tables_are_those_of_the_committed_results():
    tables = load("benchmarks/readme_tables.py")
    assert tables.with_tables(README) == README, "run: python benchmarks/readme_tables.py"
    assert tables.with_tables(README.replace("200, 200, 200", "200, 200, 199")) == README
    study = tables.STUDY.read_text()
    assert tables.with_tables(study, tables.STUDY) == study, "run: python benchmarks/readme_tables.py"
    assert study.count("\n| `") == 2 * len(tables.STEADY)
    assert README.count("\n| `") == 2 * len(tables.POLICIES) + len(tables.ONE_CAMERA)


def test_the_tables_of_the_study_of_demonstrators_are_those_of_its_results():
    tables = load("benchmarks/operator_table.py")
    page = tables.PAGE.read_text()
    assert tables.with_tables(page) == page, "run: python benchmarks/operator_table.py"
    assert page.count("| `hesitant` |") == 21
    people = {each["operator"] for each in tables.read("operators")} - {tables.EVERYBODY}
    assert [name for name in people if f"| `{name}` |" not in page] == []
    assert len(people) == 11
    assert tables.with_tables(page.replace("| `hesitant` |", "| `nobody` |")) == page


def test_the_tables_of_instructions_are_those_of_their_results(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    names = ("mode_study", "language_reading", "language")
    study, reading, following = (load(f"benchmarks/{name}.py") for name in names)
    results = json.loads(reading.RESULTS.read_text())
    for script, rows in ((reading, results), (following, following.known())):
        page, shown = script.PAGE.read_text(), script.table(rows)
        assert study.with_table(page, script.MARK, shown) == page, f"run: python {script.__file__}"
        assert study.with_table(page, script.MARK, "nothing") != page
    told: dict[str, list[float]] = {"words": [], "mean": []}
    for row in results:
        told[row["reading"]].append(row["unseen"]["direction"])
    assert min(told["words"]) > max(told["mean"])
    ratios = [
        row["ratio"] for row in json.loads((ROOT / "benchmarks/results/language_step.json").read_text())
    ]
    assert f"costs {', '.join(f'{each:.2f}' for each in ratios)} times" in reading.PAGE.read_text()
    assert max(ratios) <= 1.05


def test_the_table_of_comparisons_that_stop_early_is_that_of_its_results():
    tables = load("benchmarks/sequential.py")
    page = tables.PAGE.read_text()
    assert tables.with_table(page) == page, "run: python benchmarks/sequential.py"
    rows = [tables.Row(**each) for each in json.loads(tables.RESULTS.read_text())]
    assert page.count("| 0.5 |") == sum(row.correlation == 0.5 for row in rows) > 0
    assert {row.comparisons for row in rows} == {10_000}
    for row in rows:
        if row.first == row.second:
            assert row.wrong == row.decided <= 0.05 * row.comparisons
        elif round(row.first - row.second, 6) == 0.2:
            assert row.median_episodes <= 0.6 * tables.EPISODES


def test_the_seconds_of_an_evaluation_are_those_of_the_results():
    tables = load("benchmarks/evaluation.py")
    page, rows = tables.PAGE.read_text(), json.loads(tables.RESULTS.read_text())
    assert tables.with_table(page, rows) == page, "run: python benchmarks/evaluation.py"
    assert {each["policy"]: each["episodes"] for each in rows} == dict.fromkeys(tables.POLICIES, 200)
    for each in rows:
        assert each["cpu_s"] / each["workers"] + 10 <= 60, "a minute on two cores that are free"


def test_the_table_of_planted_faults_is_that_of_its_results():
    tables = load("benchmarks/fault_table.py")
    page, cells = tables.PAGE.read_text(), json.loads(tables.RESULTS.read_text())["cells"]
    assert tables.with_table(page, cells) == page, "run: python benchmarks/fault_table.py"
    assert f"Right: {tables.tally(cells)} that count." in page


def test_the_tables_of_exported_policies_are_those_of_their_results(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    study, tables = load("benchmarks/mode_study.py"), load("benchmarks/export.py")
    page, results = tables.PAGE.read_text(), json.loads(tables.RESULTS.read_text())
    for mark, shown in (
        (tables.CHUNKS, tables.chunks_table(results)),
        (tables.PROCESSES, tables.processes_table(results)),
    ):
        assert study.with_table(page, mark, shown) == page, "run: python benchmarks/export.py"
        assert study.with_table(page, mark, "nothing") != page
    assert all(row["difference"] <= 1e-5 for row in results["chunks"].values())
    runtime = results["processes"]["act_chunking_runtime"]
    assert runtime["has"] == []
    assert runtime["memory_mb"] <= 150
    assert runtime["seconds"] < 1
    assert results["episodes"]["difference"] <= 1e-5


def test_the_tables_of_planted_tasks_are_those_of_their_results(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    names = ("mode_study", "mode_transfer", "planted_tasks")
    study, transfer, tasks = (load(f"benchmarks/{name}.py") for name in names)
    results = json.loads(transfer.RESULTS.read_text())
    rows = json.loads((ROOT / "benchmarks" / "results" / "planted_tasks.json").read_text())["rows"]
    for script, shown in ((transfer, study.table(results)), (tasks, tasks.markdown(rows))):
        page = script.PAGE.read_text()
        assert study.with_table(page, script.MARK, shown) == page, f"run: python {script.__file__}"
        assert study.with_table(page, script.MARK, "nothing") != page


def test_the_table_of_faults_of_the_simulated_arm_is_that_of_its_results():
    tables = load("benchmarks/so_arm_faults.py")
    page, cells = tables.PAGE.read_text(), json.loads(tables.RESULTS.read_text())
    assert tables.with_table(page, cells) == page, "run: python benchmarks/so_arm_faults.py --table"
    assert len(cells) == len(tables.MODES) * len(tables.FAULTS) + len(tables.KILLED)
    assert max(cell["jump"] for cell in cells) < 1.5  # no target leaps, as the page says


def test_the_table_of_several_processes_is_that_of_its_results():
    tables = load("benchmarks/processes.py")
    results = json.loads(tables.RESULTS.read_text())
    page = (ROOT / "docs" / "guides" / "several-machines.md").read_text()
    assert tables.table(results) in page, "run: python benchmarks/processes.py"
    assert [each["case"] for each in results["cases"]] == list(tables.CASES)
    for each in results["cases"]:
        assert each["frames_seen_twice"] == 0
        assert each["apart"]["two"]["same_frames"]
        assert each["apart"]["two"]["loss"] < 1e-5


def test_the_table_of_the_study_of_modes_is_that_of_its_results():
    tables = load("benchmarks/mode_study.py")
    page, results = tables.PAGE.read_text(), json.loads(tables.RESULTS.read_text())
    shown = tables.table(results)
    assert tables.with_table(page, tables.MARK, shown) == page, "run: python benchmarks/mode_study.py"
    assert {each["learner"] for each in results} == set(tables.LEARNERS)
    assert shown.count("| 80/15/5 |") == sum(each["shares"] == "80/15/5" for each in results)
    assert max(each["training_cpu_s"] or 0 for each in results) <= 60
    for each in results:
        assert (each["verdict"] == "fail") is bool(
            each["episodes"]["missing"] or each["episodes"]["invalid"] > 10
        )


def test_the_table_of_executors_is_that_of_its_results_which_are_the_same():
    tables = load("benchmarks/executors.py")
    page, result = tables.PAGE.read_text(), json.loads(tables.RESULTS.read_text())
    assert tables.with_table(page, result) == page, "run: python benchmarks/executors.py --table"
    assert tables.with_table(page.replace("| `ray` |", "| `none` |"), result) == page
    assert result["same"]
    assert set(result["eval_same"].values()) == {True}
    assert result["killed"] == {name: {"died": 1, "same": True} for name in tables.EXECUTORS}


def test_the_readme_fits_on_a_few_screens():
    lines = README.splitlines()
    assert len(lines) <= 140
    assert [line for line in lines if len(line) > 140] == []


def test_the_picture_is_small():
    (picture,) = re.findall(r"!\[[^]]*\]\(([^)]+)\)", README)
    assert 10_000 < (ROOT / picture).stat().st_size < 3_000_000


def test_the_gate_runs_the_test_command_of_the_readme():
    (command,) = re.findall(r"^(uv run pytest[^#\n]*?) *(?:#.*)?$", README, flags=re.M)
    gate = (ROOT / ".ci" / "run").read_text()
    assert command == "uv run pytest -n 2"
    assert re.search(rf"^{command}( --durations=\d+)? \|\| status=\$\?$", gate, flags=re.M)
    assert gate.endswith('exit "$status"\n')


@pytest.fixture
def checkpoint(tmp_path, monkeypatch):
    """An untrained policy where README's Python looks for one."""
    torch.manual_seed(0)  # of random policies, one in thirty happens to succeed
    config = ac.ActChunkedConfig(
        device="cpu",
        push_to_hub=False,
        chunk_size=20,
        dim_model=16,
        n_heads=2,
        n_encoder_layers=1,
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (14,)),
            "observation.environment_state": PolicyFeature(FeatureType.ENV, (7,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (14,))},
    )
    folder = tmp_path / CHECKPOINT
    get_policy_class("act_chunked")(config).save_pretrained(folder)
    for pipeline in make_pre_post_processors(config):
        pipeline.save_pretrained(folder)
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("checkpoint")
@pytest.mark.parametrize("page", ["README.md", "docs/reference/python.md"])
def test_the_python_of_a_page_runs(page):
    blocks = python_blocks(ROOT / page)
    assert blocks
    for block in blocks:
        names = {}
        exec(block, names)
        if "info" in names:
            assert names["done"]
            assert names["info"]["is_success"] is False
            assert "(14,)" in str(names["env"].action_space)
        else:
            assert names["action"].shape == (1, 14)


@pytest.mark.parametrize("page", DOCS, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_python_of_every_page_is_python(page):
    for block in python_blocks(page):
        assert compile(block, str(page), "exec")


@pytest.mark.parametrize("page", DOCS, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_page_begins_with_what_it_gives_and_soon_has_a_command(page):
    title, blank, first, *rest = page.read_text().splitlines()
    assert title.startswith("# ")
    assert blank == ""
    assert re.match(r"\[?[`\w]", first)
    assert "```" in "\n".join(rest[:40])


def pages_of(nav):
    for entry in nav:
        for value in entry.values():
            if isinstance(value, str):
                yield value
            else:
                yield from pages_of(value)


def test_the_site_has_every_page_once():
    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    listed = list(pages_of(site["nav"]))
    assert sorted(listed) == sorted(str(page.relative_to(ROOT / "docs")) for page in DOCS)
    assert site["theme"]["font"] is False


@pytest.mark.parametrize(
    ("link", "shown"),
    [
        ("[the table](../../lerobot_act_chunking/envs)", "the table (`lerobot_act_chunking/envs`)"),
        ("[configs/act.yaml](../../configs/act.yaml)", "`configs/act.yaml`"),
        ("[chunks](../guides/execution.md#modes)", "[chunks](../guides/execution.md#modes)"),
        ("![a picture](../images/steps.png)", "![a picture](../images/steps.png)"),
        ("[below](#modes)", "[below](#modes)"),
    ],
)
def test_links_out_of_the_docs_are_paths_on_the_site(link, shown):
    page = SimpleNamespace(file=SimpleNamespace(src_uri="policies/act.md"))
    assert load(".ci/docs_links.py").on_page_markdown(link, page=page, config=None, files=None) == shown


def test_the_public_names_are_those_of_the_reference():
    page = (ROOT / "docs" / "reference" / "python.md").read_text()
    assert set(re.findall(r"`ac\.(\w+)", page)) == set(ac.__all__)
