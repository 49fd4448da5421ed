"""LeRobot's own commands over checkpoints of LeRobot's policies and of ours, bare and wrapped."""

import json
import shutil
import sys
from pathlib import Path

import pytest
import torch
from lerobot.configs import FeatureType, PreTrainedConfig
from lerobot.envs.utils import env_to_policy_features
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.scripts import lerobot_eval

import lerobot_act_chunking.policies.act_chunked.configuration_act_chunked
import lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked
import lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked  # noqa: F401  (register)
from lerobot_act_chunking.cli.wrap import wrap_command
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.execution.executor import ChunkExecutor

pytestmark = pytest.mark.slow

TRANSFORMER = {"dim_model": 16, "n_heads": 2, "dim_feedforward": 24, "n_encoder_layers": 1, "use_vae": False}
INNER = {
    "act": {**TRANSFORMER, "chunk_size": 12, "n_action_steps": 12},
    "act_chunked": {**TRANSFORMER, "chunk_size": 12},
    "diffusion_chunked": {"horizon": 4, "chunk_stride": 4, "dim_model": 16, "n_layers": 1},
    "vqbet_chunked": {
        "chunk_size": 4,
        "chunk_stride": 4,
        "gpt_hidden_dim": 16,
        "gpt_n_layer": 1,
        "tokenizer": "fsq",
    },
    "diffusion": {
        "horizon": 16,
        "n_action_steps": 8,
        "down_dims": (8, 16),
        "n_groups": 4,
        "diffusion_step_embed_dim": 8,
        "num_train_timesteps": 5,
    },
}
STEPS, EPISODES = 20, 2


def checkpoint(policy_type: str, folder: Path) -> Path:
    """A policy for `aloha_sim` that has learned nothing, with its processors."""
    features = env_to_policy_features(AlohaSimEnvConfig(obs_type="state"))
    actions = {key: feature for key, feature in features.items() if feature.type is FeatureType.ACTION}
    config = PreTrainedConfig.get_choice_class(policy_type)(
        input_features={key: feature for key, feature in features.items() if key not in actions},
        output_features=actions,
        device="cpu",
        push_to_hub=False,
        **INNER[policy_type],
    )
    statistics = {
        key: {
            name: torch.full(feature.shape, value)
            for name, value in {"mean": 0.1, "std": 0.3, "min": -1.0, "max": 1.0}.items()
        }
        for key, feature in features.items()
    }
    torch.manual_seed(0)
    policy = get_policy_class(policy_type)(config)
    for part in (policy, *make_pre_post_processors(config, dataset_stats=statistics)):
        part.save_pretrained(folder)
    return folder


@pytest.fixture
def evaluate(monkeypatch, tmp_path):
    """Run lerobot-eval; returns how many episodes it counts and every chunk that the network predicted."""

    def run(*policy: str) -> tuple[int, list[torch.Tensor]]:
        chunks, add = [], ChunkExecutor.add

        def recording(executor, chunk, *arguments):
            chunks.append(chunk)
            add(executor, chunk, *arguments)

        output = tmp_path / f"eval_{len(list(tmp_path.iterdir()))}"
        sizes = f"--env.episode_length={STEPS} --eval.n_episodes={EPISODES} --eval.batch_size={EPISODES}"
        video = "--env.render_quality=fast --env.visualization_height=48 --env.visualization_width=64"
        arguments = f"--env.type=aloha_sim --env.obs_type=state {sizes} {video} --eval.use_async_envs=false"
        with monkeypatch.context() as patch:
            patch.setattr(ChunkExecutor, "add", recording)
            command = [*policy, "--policy.device=cpu", *arguments.split(), f"--output_dir={output}"]
            patch.setattr(sys, "argv", ["lerobot-eval", *command])
            lerobot_eval.main()
        return json.loads((output / "eval_info.json").read_text())["overall"]["n_episodes"], chunks

    return run


@pytest.mark.parametrize("policy_type", INNER)
def test_lerobot_eval_over_a_checkpoint_and_over_its_wrapped_copy(policy_type, evaluate, tmp_path):
    inner = checkpoint(policy_type, tmp_path / "inner")
    episodes, chunks = evaluate(
        "--policy.type=temporal_ensemble", f"--policy.inner_path={inner}", "--policy.replan_interval=5"
    )
    assert (episodes, len(chunks)) == (EPISODES, STEPS // 5)
    wrap_command(str(inner), tmp_path / "wrapped", replan_interval=5)
    shutil.rmtree(inner)
    _, copied = evaluate(f"--policy.path={tmp_path / 'wrapped'}")
    for chunk, copy in zip(chunks, copied, strict=True):
        assert torch.equal(chunk, copy)


@pytest.mark.parametrize(
    ("policy_type", "settings"),
    [
        ("diffusion_chunked", "--policy.warm_start=rtc --policy.rtc_vjp=exact --policy.latency_steps=2"),
        ("diffusion_chunked", "--policy.warm_start=sdedit --policy.execution=receding"),
        ("diffusion_chunked", "--policy.warm_start=noise_hold"),
        ("diffusion_chunked", "--policy.execution=coherence --policy.sampler=heun"),
        ("vqbet_chunked", "--policy.bet_softmax_temperature=0 --policy.execution=receding"),
        ("vqbet_chunked", "--policy.code_hold=episode --policy.top_p=0.5"),
        ("vqbet_chunked", "--policy.execution=coherence --policy.noise_seed=3"),
    ],
)
def test_sampling_is_set_on_the_command_line(policy_type, settings, evaluate, tmp_path):
    path = checkpoint(policy_type, tmp_path / "policy")
    episodes, chunks = evaluate(f"--policy.path={path}", "--policy.replan_interval=4", *settings.split())
    assert (episodes, len(chunks)) == (EPISODES, STEPS // 4)
    assert all(torch.isfinite(chunk).all() for chunk in chunks)


def test_another_execution_on_the_command_line(evaluate, tmp_path):
    wrap_command(str(checkpoint("act", tmp_path / "inner")), tmp_path / "wrapped")
    _, chunks = evaluate(f"--policy.path={tmp_path / 'wrapped'}", "--policy.execution=open_loop")
    assert len(chunks) == 2


def test_lerobot_eval_refuses_a_wrapper_over_nothing(evaluate, capfd):
    with pytest.raises(SystemExit):
        evaluate("--policy.type=temporal_ensemble")
    assert "set either --policy.inner_path=<checkpoint> or --policy.inner=" in capfd.readouterr().err
