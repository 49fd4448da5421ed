import json
from pathlib import Path

import draccus
import pytest
import yaml
from lerobot.configs.train import TrainPipelineConfig

import lerobot_act_chunking.plugin  # noqa: F401
from lerobot_act_chunking.cli import main as cli
from lerobot_act_chunking.cli import quickstart
from lerobot_act_chunking.cli.quickstart import QuickstartPlan

CONFIG = Path(__file__).parents[2] / "configs" / "quickstart.yaml"


def parse_train(command: list[str]) -> dict:
    assert command[0] == "lerobot-train"
    return draccus.encode(draccus.parse(TrainPipelineConfig, args=command[1:]))


def test_the_printed_training_command_is_the_committed_config():
    command = QuickstartPlan(Path("outputs/quickstart")).train_command()
    into_the_hub = {
        "--policy.push_to_hub=true": "--policy.push_to_hub=false",
        "--policy.repo_id=local/act_transfer_cube": "",
    }
    command = [into_the_hub.get(flag, flag) for flag in command if into_the_hub.get(flag, flag)]
    from_yaml = draccus.encode(draccus.decode(TrainPipelineConfig, yaml.safe_load(CONFIG.read_text())))
    assert parse_train(command) == from_yaml


def test_stages_run_in_order_and_finished_ones_are_skipped(tmp_path, monkeypatch, capsys):
    ran = []

    def fake_run(command, console):
        ran.append(command[:2])
        plan = QuickstartPlan(tmp_path, steps=3)
        name = " ".join(command[:2])
        if name == "act-chunking record":
            touch(plan.dataset / "meta" / "info.json")
        elif command[0] == "lerobot-train":
            touch(plan.train / "checkpoints" / "000003" / "pretrained_model" / "config.json")
            touch(plan.hub / "models--local--act_transfer_cube" / "refs" / "main")
        elif command[0] == "lerobot-eval":
            successes = {"per_task": [{"metrics": {"successes": [True, True, False, True]}}]}
            touch(plan.evaluation / "eval_info.json", json.dumps(successes))
        else:
            touch(plan.picture)

    monkeypatch.setattr(quickstart, "run", fake_run)
    monkeypatch.setenv("LEROBOT_LOCAL_HUB", str(tmp_path / "hub"))
    argv = ["quickstart", "--output-dir", str(tmp_path), "--steps", "3"]
    assert cli.main(argv) == 0
    assert [command[0] for command in ran] == [
        "act-chunking",
        "lerobot-train",
        "lerobot-eval",
        "act-chunking",
    ]
    assert "75.0 % (3/4 episodes, 95 % Wilson interval 30.1-95.4 %)" in capsys.readouterr().out

    ran.clear()
    (tmp_path / "motion.png").unlink()
    assert cli.main(argv) == 0
    assert [command[:2] for command in ran] == [["act-chunking", "motion"]]


def test_an_interrupted_training_resumes_from_its_checkpoint(tmp_path):
    plan = QuickstartPlan(tmp_path)
    touch(plan.checkpoint / "config.json")
    assert plan.train_command() == [
        "lerobot-train",
        f"--config_path={plan.checkpoint}/train_config.json",
        "--resume=true",
    ]
    assert not plan.trained()


def test_training_output_without_a_checkpoint_is_cleared_but_checkpoints_never(tmp_path):
    plan = QuickstartPlan(tmp_path)
    touch(plan.train / "leftover.txt")
    quickstart.train_afresh_or_on(plan)
    assert not plan.train.exists()

    touch(plan.checkpoint / "config.json")
    quickstart.train_afresh_or_on(plan)
    assert (plan.checkpoint / "config.json").exists()


def test_a_failing_command_stops_the_story_and_is_named(tmp_path, capsys):
    with pytest.raises(quickstart.StageFailedError, match="python ended with status 3"):
        quickstart.run(["python", "-c", "raise SystemExit(3)"], quickstart.Console())
    assert "$ python -c 'raise SystemExit(3)'" in capsys.readouterr().out


def test_a_command_stopped_by_ctrl_c_counts_as_ctrl_c():
    with pytest.raises(KeyboardInterrupt):
        quickstart.run(["python", "-c", "raise SystemExit(130)"], quickstart.Console())


@pytest.mark.parametrize(
    ("argv", "held"),
    [
        (["--task", "insertion"], "task=transfer_cube"),
        (["--steps", "9", "--seed", "1"], "steps=4000, seed=0"),
    ],
)
def test_results_of_another_story_never_pass_for_this_ones(tmp_path, capsys, argv, held):
    quickstart.claim_folder(QuickstartPlan(tmp_path))
    quickstart.claim_folder(QuickstartPlan(tmp_path))
    assert cli.main(["quickstart", "--output-dir", str(tmp_path), *argv]) == 1
    assert f"holds a quickstart with {held}; repeat those settings" in capsys.readouterr().err


def test_unknown_task_is_refused_before_anything_runs(tmp_path, capsys):
    assert cli.main(["quickstart", "--task", "juggle", "--output-dir", str(tmp_path)]) == 1
    assert "unknown task 'juggle'; choose one of: transfer_cube, insertion" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def touch(path: Path, text: str = "{}") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def test_trained_means_pushed(tmp_path, monkeypatch):
    monkeypatch.setenv("LEROBOT_LOCAL_HUB", str(tmp_path / "hub"))
    story = QuickstartPlan(tmp_path, steps=3)
    (story.train / "checkpoints" / "000003").mkdir(parents=True)
    assert not story.trained()
    main = story.hub / f"models--{story.policy_repo_id.replace('/', '--')}" / "refs" / "main"
    main.parent.mkdir(parents=True)
    main.write_text("0" * 40)
    assert story.trained()


def test_it_is_listed_and_its_wrong_usage_is_status_2(capsys):
    assert cli.main(["--help"]) == 0
    assert "quickstart" in capsys.readouterr().out
    assert cli.main(["quickstart", "--episodes", "0"]) == 2
    assert "Invalid value for '--episodes'" in capsys.readouterr().err


def test_ctrl_c_is_status_130_and_says_how_to_go_on(monkeypatch, capsys, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(quickstart, "run", interrupted)
    monkeypatch.setenv("LEROBOT_LOCAL_HUB", str(tmp_path / "hub"))
    assert cli.main(["quickstart", "--output-dir", str(tmp_path)]) == 130
    assert "run the same command again" in capsys.readouterr().err


@pytest.mark.parametrize("damage", [b"", b"[" * 100_000, b"3", b"\xff"])
def test_a_damaged_note_is_refused_and_can_be_removed(tmp_path, capsys, damage):
    quickstart.claim_folder(QuickstartPlan(tmp_path))
    (tmp_path / "quickstart.json").write_bytes(damage)
    assert cli.main(["quickstart", "--output-dir", str(tmp_path)]) == 1
    assert "quickstart.json is damaged" in capsys.readouterr().err
    (tmp_path / "quickstart.json").unlink()
    quickstart.claim_folder(QuickstartPlan(tmp_path))
