"""LeRobot's evaluation command in this process."""

import json
import sys

import pytest
import torch
from evaluations import EPISODES, STEPS
from lerobot.scripts import lerobot_eval

from act_chunking_runtime.executor import ChunkExecutor


@pytest.fixture
def evaluate(monkeypatch, tmp_path):
    """Run lerobot-eval; returns how many episodes it counts and every chunk that the network predicted."""

    def run(*policy: str) -> tuple[int, list[torch.Tensor]]:
        chunks, add = [], ChunkExecutor.add

        def recording(executor, chunk, *arguments):
            chunks.append(torch.tensor(chunk))
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
