import errno
import os
from pathlib import Path

import pytest
import torch
import typer
from huggingface_hub import HfApi, constants, set_client_factory
from huggingface_hub.utils._http import default_client_factory
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from typer.testing import CliRunner

from lerobot_act_chunking import hub
from lerobot_act_chunking.cli.wrap import wrap_command
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies import saving
from lerobot_act_chunking.policies.loading import load_policy
from lerobot_act_chunking.policies.temporal_ensemble import wrapping

app = typer.Typer()
app.command()(wrap_command)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    folder = tmp_path_factory.mktemp("act") / "pretrained_model"
    config = ACTConfig(
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (6,)),
            "observation.environment_state": PolicyFeature(FeatureType.ENV, (7,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (4,))},
        device="cpu",
        push_to_hub=False,
        dim_model=16,
        n_heads=2,
        dim_feedforward=24,
        n_encoder_layers=1,
        use_vae=False,
        chunk_size=9,
        n_action_steps=5,
    )
    statistics = {
        key: {"mean": torch.zeros(n), "std": torch.full((n,), 2.0)}
        for key, n in (("observation.state", 6), ("action", 4))
    }
    for part in (ACTPolicy(config), *make_pre_post_processors(config, dataset_stats=statistics)):
        part.save_pretrained(folder)
    return folder


def wrap(*arguments):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_it_writes_a_checkpoint_with_other_execution(checkpoint, tmp_path):
    out = tmp_path / "runs" / "wrapped"
    options = "--execution adaptive --replan-interval 3 --n-action-steps 8 --coeff 0.1 --weighting recency"
    more = (
        "--latency-steps 1 --adaptive-kernel cosine --adaptive-scale 2 --gripper-dims 1,3 --smoothing-steps 3"
    )
    result = wrap(checkpoint, "--out", out, *options.split(), *more.split())
    assert "act, chunks of 9 control steps; execution=adaptive, a new chunk every 3 steps" in result.output
    assert f"lerobot-eval --policy.path={out} --env.type=" in result.output
    settings = load_policy(out).policy.config.execution_settings
    assert (settings.execution, settings.replan_interval, settings.n_action_steps) == ("adaptive", 3, 8)
    assert (settings.temporal_ensemble_coeff, settings.ensemble_weighting) == (0.1, "recency")
    assert (settings.latency_steps, settings.adaptive_kernel, settings.adaptive_scale) == (1, "cosine", 2)
    assert (settings.gripper_dims, settings.smoothing_steps) == ((1, 3), 3)
    assert [path.name for path in out.parent.iterdir()] == ["wrapped"]


def test_the_wrapped_checkpoint_acts_like_the_original_in_raw_units(checkpoint, tmp_path):
    out = tmp_path / "wrapped"
    wrap(checkpoint, "--out", out, "--execution", "open_loop", "--n-action-steps", 5)
    raw = {"observation.state": torch.ones(2, 6), "observation.environment_state": torch.ones(2, 7)}
    actions = []
    for folder in (checkpoint, out):
        policy, preprocessor, postprocessor = load_policy(folder)
        actions.append(postprocessor(policy.select_action(preprocessor(raw))))
    assert torch.equal(*actions)


def test_an_existing_folder_is_refused_before_anything_is_loaded(tmp_path):
    with pytest.raises(ConfigurationError, match="exists already"):
        wrap("./nowhere", "--out", tmp_path)


def test_execution_that_cannot_work_leaves_nothing(checkpoint, tmp_path):
    with pytest.raises(ConfigurationError, match="crossfade_steps=8 must be between 1 and"):
        wrap(checkpoint, "--out", tmp_path / "wrapped", "--execution=crossfade", "--crossfade-steps=8")
    with pytest.raises(ConfigurationError, match="inner act always predicts the same one"):
        wrap(checkpoint, "--out", tmp_path / "wrapped", "--execution=coherence", "--n-samples=4")
    assert list(tmp_path.iterdir()) == []


def test_dimensions_that_are_no_numbers_are_a_usage_error(checkpoint, tmp_path):
    result = wrap(checkpoint, "--out", tmp_path / "wrapped", "--gripper-dims=left")
    assert result.exit_code == 2
    assert "not a list of dimensions" in result.output


@pytest.mark.parametrize(
    ("failure", "expected"),
    [
        (KeyboardInterrupt(), KeyboardInterrupt),
        (OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), ConfigurationError),
    ],
    ids=["ctrl-c", "full disk"],
)
def test_an_interrupted_write_leaves_nothing(checkpoint, tmp_path, monkeypatch, failure, expected):
    loaded = wrapping.load_wrapped(checkpoint)

    def fail(folder):
        assert (Path(folder) / "model.safetensors").exists()
        raise failure

    monkeypatch.setattr(loaded.postprocessor, "save_pretrained", fail)
    with pytest.raises(expected) as raised:
        saving.save_checkpoint(loaded, tmp_path / "wrapped")
    if expected is ConfigurationError:
        assert "could not be written, and nothing of it was kept" in str(raised.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.filterwarnings("ignore:Use 'content=:DeprecationWarning")  # httpx's, for every upload
def test_a_repository_of_the_local_hub(checkpoint, tmp_path, monkeypatch):
    monkeypatch.setenv("LEROBOT_LOCAL_HUB", str(tmp_path / "hub"))
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "downloads"))
    try:
        hub.install()
        HfApi().create_repo("me/act")
        HfApi().upload_folder(repo_id="me/act", folder_path=checkpoint)
        wrap("me/act", "--out", tmp_path / "wrapped")
    finally:
        set_client_factory(default_client_factory)
    assert load_policy(tmp_path / "wrapped").policy.config.inner["type"] == "act"
