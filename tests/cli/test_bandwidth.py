"""``act-chunking bandwidth`` as a user meets it."""

import json

import pytest
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig

from lerobot_act_chunking.cli.main import main

REFUSED, DONE, FAILED, UNDECIDED = 1, 0, 11, 10


@pytest.fixture
def lerobot_act(tmp_path):
    """The configuration of a LeRobot ACT checkpoint that favours new chunks; the command reads no weights."""
    config = ACTConfig(
        chunk_size=20,
        n_action_steps=1,
        temporal_ensemble_coeff=-0.1,
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, (6,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (4,))},
        device="cpu",
        push_to_hub=False,
    )
    folder = tmp_path / "checkpoint"
    folder.mkdir()
    config._save_pretrained(folder)
    return str(folder)


def test_ensembles_of_few_chunks(tmp_path, capsys):
    numbers, picture = tmp_path / "new" / "bandwidth.json", tmp_path / "bandwidth.png"
    command = (
        "bandwidth --chunk-size 100 --replan-interval 1 --weighting act --coeff 0.01 --latency-steps 0 "
        f"--fps 50 --json {numbers} --out {picture}"
    )
    assert main(command.split()) == DONE
    content = json.loads(numbers.read_text())
    assert content["bandwidth_hz"] == pytest.approx(0.228, abs=5e-4)
    assert content["group_delay_steps"] == pytest.approx(57.70, abs=5e-3)
    assert content["settle_90_steps"] == 93
    assert len(content["impulse_response"]) == 100
    assert content["measured"]["step_error"] <= 1e-6
    assert content["measured"]["noise_error"] <= 0.05
    assert picture.read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "0.228 Hz" in printed
    assert "the plan, passes with gain 1" in " ".join(printed.split())


def test_a_checkpoint_supplies_the_numbers_and_options_win(lerobot_act, tmp_path):
    numbers = tmp_path / "bandwidth.json"
    assert main(["bandwidth", lerobot_act, "--json", str(numbers)]) == DONE
    content = json.loads(numbers.read_text())
    assert content["policy_type"] == "act"
    assert content["group_delay_steps"] == pytest.approx(6.38, abs=5e-3)  # recency: the sign was negative
    assert (
        main(["bandwidth", lerobot_act, "--weighting", "act", "--coeff", "0.1", "--json", str(numbers)])
        == DONE
    )
    assert json.loads(numbers.read_text())["group_delay_steps"] == pytest.approx(12.62, abs=5e-3)


@pytest.mark.parametrize(
    ("arguments", "status"),
    [
        ("--chunk-size 20 --max-settle-s 2 --disturbance-hz 0.2", DONE),
        ("--chunk-size 20 --max-settle-s 0.1", FAILED),
        ("--chunk-size 12 --execution adaptive --replan-interval 3 --disturbance-hz 1", UNDECIDED),
    ],
)
def test_exit_status(arguments, status, capsys):
    assert main(["bandwidth", *arguments.split()]) == status
    assert "error" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--coeff -0.1", "temporal_ensemble_coeff=-0.1 must be at least 0"),
        ("--chunk-size 10 --replan-interval 11", "replan_interval=11 must be below n_action_steps=10"),
        ("--chunk-size 10 --replan-interval 8 --latency-steps 3", "exceeds n_action_steps=10"),
        ("--latency-steps -1", "latency_steps=-1 must be at least 0"),
        ("--fps 0", "fps=0.0 must be a positive number"),
        ("--fps -50", "fps=-50.0 must be a positive number"),
        ("--chunk-size 0", "chunk_size=0 must be at least 1"),
        ("--replan-interval 0", "replan_interval=0 must be at least 1"),
        ("--disturbance-hz 0", "disturbance_hz=0.0 must be a positive number"),
        ("--weighting uniform --coeff 0.1", "has no effect with ensemble_weighting=uniform"),
        ("--env transfer_cube", "give a checkpoint before --env"),
        ("outputs/nowhere/pretrained_model", "there is no checkpoint at outputs/nowhere/pretrained_model"),
        ("--weighting newest", "unknown ensemble_weighting 'newest'; choose one of: act, recency, uniform"),
        ("--execution fast", "unknown execution 'fast'; choose one of: open_loop, receding, ensemble"),
    ],
)
def test_refuses_what_cannot_work(arguments, message, capsys):
    assert main(["bandwidth", *arguments.split()]) == REFUSED
    assert message in " ".join(capsys.readouterr().err.split())


def test_help_explains_the_exit_status(capsys):
    assert main(["bandwidth", "--help"]) == DONE
    printed = " ".join(capsys.readouterr().out.replace("│", "").split())
    assert "Exit status: 0 within the limits given" in printed
    assert "default: 100" in printed  # brackets would be taken for markup and vanish
    assert "within this time, in s" in printed


def test_the_files_are_there_even_if_nobody_reads_the_output(tmp_path, monkeypatch):
    def closed(*_, **__):
        raise BrokenPipeError

    monkeypatch.setattr("lerobot_act_chunking.diagnostics.bandwidth.terminal.print_report", closed)
    with pytest.raises(BrokenPipeError):
        main(["bandwidth", "--chunk-size", "10", "--json", str(tmp_path / "bandwidth.json")])
    assert json.loads((tmp_path / "bandwidth.json").read_text())["settle_90_steps"] == 9
