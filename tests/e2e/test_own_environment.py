"""The example of docs/guides/own-environment.md: found by LeRobot's commands, trained in, evaluated."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from lerobot.envs.utils import env_to_policy_features
from policy_cases import MODULES, TYPES
from tiers import full_tier

from lerobot_act_chunking.errors import ConfigurationError

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_environment.py"


@pytest.fixture
def own(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLE.parent)
    return importlib.import_module("own_environment")


def test_it_is_sixty_lines_or_fewer():
    assert len(EXAMPLE.read_text().splitlines()) <= 60


def test_gymnasiums_checker_passes(own):
    check_env(own.ReachDot(), skip_render_check=True)


def test_the_dot_can_be_reached(own):
    env = own.ReachDot()
    observation, info = env.reset(seed=3)
    assert info["is_success"] is False
    for _ in range(60):
        error = observation["environment_state"] - observation["agent_pos"][:2]
        observation, reward, terminated, _, info = env.step(4 * error)
        if terminated:
            break
    assert info["is_success"] is True
    assert -0.08 < reward < 0


def test_an_image_shows_the_dot(own):
    env = own.ReachDot()
    env.reset(seed=3)
    image = env.render()
    assert (image.shape, image.dtype) == ((96, 128, 3), np.uint8)
    assert image.max() > 60
    env.renderer.close()


def test_policies_get_its_features(own):
    features = {key: value.shape for key, value in env_to_policy_features(own.ReachDotConfig()).items()}
    assert own.ReachDotConfig().fps == own.ReachDot.metadata["render_fps"]
    assert features == {"action": (2,), "observation.state": (4,), "observation.environment_state": (2,)}
    with pytest.raises(ConfigurationError, match="obs_type pixels needs cameras"):
        own.ReachDotConfig(obs_type="pixels")


@full_tier
def test_lerobot_eval_finds_it(tmp_path):
    """In a process of its own and with asynchronous workers, which must find the file as well."""
    policy = f"--policy.type={TYPES[0]} {MODULES[TYPES[0]].TRAINED}"
    quiet = "--policy.device=cpu --policy.push_to_hub=false"
    environment = "--env.discover_packages_path=own_environment --env.type=reach_dot"
    size = f"--eval.n_episodes=2 --eval.batch_size=2 --eval.use_async_envs=true --output_dir={tmp_path}"
    code = "from lerobot.scripts.lerobot_eval import main; main()"
    subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, *f"{policy} {quiet} {environment} {size}".split()],
        env={**os.environ, "PYTHONPATH": str(EXAMPLE.parent)},
        check=True,
        timeout=280,
    )
    assert json.loads((tmp_path / "eval_info.json").read_text())["overall"]["n_episodes"] == 2
