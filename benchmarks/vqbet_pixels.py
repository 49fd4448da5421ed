"""`vqbet_chunked` from one camera, and LeRobot's `vqbet` beside it with the same data and minutes.

    OMP_NUM_THREADS=1 python benchmarks/vqbet_pixels.py

Records 50 demonstrations of transfer_cube with one camera of 128 x 96 pixels, trains both policies on that
camera and the joints' positions (where the cube lies can only be seen), and lets both act in the same 200
unseen episodes. Prints a table. Every step is skipped if its result is there, so it can be stopped and gone
on with.
"""

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import yaml
from execution_study import FIRST_SEED
from policy_study import act
from policy_training import Training, Variant
from rich.console import Console
from rich.table import Table

from lerobot_act_chunking.cli.quickstart import QuickstartPlan, run
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.core.rollouts import Rollout

TASK, CAMERA, HEIGHT, WIDTH = "transfer_cube", "top", 96, 128
N_ENVS = 50
STAGES = ("none", "touched", "lifted", "handed over", "transferred")
"""What an episode's highest reward stands for."""

RECIPE: dict[str, Any] = yaml.safe_load((Path(__file__).parents[1] / "configs/vqbet_pixels.yaml").read_text())

# Nothing can be downloaded, so the ResNet learns from scratch, with GroupNorm. The GPT is as wide as ours, a
# chunk as long as what ours executes of one, and only the current observation is seen, as by ours: with the
# defaults (512 x 8, five observations) a step takes several times as long. The crop leaves out black margins.
LEROBOT: dict[str, Any] = {
    "type": "vqbet",
    "device": "cpu",
    "push_to_hub": False,
    "n_obs_steps": 1,
    "action_chunk_size": 25,
    "crop_shape": "[84,112]",
    "crop_is_random": False,
    "pretrained_backbone_weights": "null",
    "use_group_norm": True,
    "n_vqvae_training_steps": 4000,
    **{f"gpt_{part}_dim": 128 for part in ("input", "output", "hidden")},
    "gpt_n_layer": 4,
    "gpt_n_head": 4,
    "optimizer_lr": 5e-4,
    "scheduler_warmup_steps": 100,
}


LOOKS = RECIPE["policy"]["replan_interval"]
"""Control steps from one look at the camera to the next, of both policies."""


class SameReader(Variant):
    """LeRobot's policy, reading with this package's reader.

    LeRobot's own decodes the images of a chunk's every step to give back the first: most of its minutes
    would be that.
    """

    @property
    def is_lerobot(self) -> bool:
        """Not as to the reader."""
        return False


VARIANTS = {
    "vqbet_chunked": Variant(
        {name: "null" if value is None else value for name, value in RECIPE["policy"].items()},
        RECIPE["steps"],
        RECIPE["batch_size"],
    ),
    "LeRobot vqbet": SameReader(LEROBOT, steps=5350, batch_size=16),
}


class SeldomRendered(AlohaSimEnv):
    """Renders when the policies look, and repeats that image in between: rendering takes most of a step."""

    def reset(self, **asked: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode."""
        self._steps = 0
        return super().reset(**asked)

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Advance one control step."""
        self._steps += 1
        return super().step(action)

    def _image(self, camera: str, height: int, width: int) -> np.ndarray:
        if self._steps % LOOKS == 0:
            self._seen = super()._image(camera, height, width)
        return self._seen


@dataclass
class SeldomRenderedConfig(AlohaSimEnvConfig):
    """Its configuration."""

    @property
    def type(self) -> str:
        """Its name in LeRobot, which knows the environment itself alone."""
        return "aloha_sim"

    @property
    def gym_id(self) -> str:
        """Its name in gymnasium."""
        return "vqbet_pixels/SeldomRendered-v0"


gym.register("vqbet_pixels/SeldomRendered-v0", SeldomRendered)


@dataclass(frozen=True)
class Cell:
    """One policy.

    Attributes:
        policy: its name.
        train: steps, minutes on the clock, minutes of CPU, parameters.
        stages: how far each seed's episode came, an index of `STAGES`.
    """

    policy: str
    train: dict[str, Any]
    stages: dict[int, int]

    @property
    def rate(self) -> SuccessRate:
        """The success rate."""
        return SuccessRate(Counter(self.stages.values())[len(STAGES) - 1], len(self.stages))


def record(folder: Path, console: Console) -> QuickstartPlan:
    """The demonstrations, with their frames as single images."""
    plan, video = QuickstartPlan(folder, TASK), folder / "video"
    if not plan.recorded():
        command = ["act-chunking", "record", "--task", TASK, "--episodes", "50", "--obs", "pixels_state"]
        command += ["--cameras", CAMERA, "--image-height", str(HEIGHT), "--image-width", str(WIDTH)]
        run([*command, "--render-quality", "fast", "--repo-id", plan.repo_id, "--root", str(video)], console)
        keep_as_images(video, plan)
    return plan


def keep_as_images(video: Path, plan: QuickstartPlan) -> None:
    """A copy of a recording with one image per frame: a frame of a video costs decoding its neighbours."""
    import shutil

    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    recorded = LeRobotDataset(plan.repo_id, root=video, video_backend="pyav")
    image = f"observation.images.{CAMERA}"
    features = {key: recorded.features[key] for key in ("observation.state", "action")}
    features[image] = {
        "dtype": "image",
        "shape": (HEIGHT, WIDTH, 3),
        "names": ["height", "width", "channels"],
    }
    part = plan.dataset.with_suffix(".part")
    shutil.rmtree(part, ignore_errors=True)
    copy = LeRobotDataset.create(plan.repo_id, recorded.fps, features, root=part, use_videos=False)
    table = recorded.hf_dataset.select_columns(["observation.state", "action", "episode_index"])
    rows: list[Any] = list(table.with_format("numpy"))
    following = [*(row["episode_index"] for row in rows[1:]), None]
    for row, after, frame in zip(rows, following, frames(video), strict=True):
        copy.add_frame(
            {key: row[key] for key in ("observation.state", "action")} | {image: frame, "task": TASK}
        )
        if after != row["episode_index"]:
            copy.save_episode()
    copy.finalize()
    part.rename(plan.dataset)


def frames(dataset: Path) -> Iterator[Any]:
    """All frames of a recording, (height, width, 3), in their order."""
    import av

    for path in sorted(dataset.rglob("*.mp4")):
        with av.open(str(path)) as container:
            for frame in container.decode(video=0):
                yield frame.to_ndarray(format="rgb24")


def evaluate(name: str, training: Training, episodes: int) -> Cell:
    """One policy's cell; each group of episodes is written down when it is done."""
    from lerobot_act_chunking.policies.loading import load_policy

    path = training.folder / "stages.json"
    stages = (
        {int(seed): stage for seed, stage in json.loads(path.read_text()).items()} if path.exists() else {}
    )
    seeds = [seed for seed in range(FIRST_SEED, FIRST_SEED + episodes) if seed not in stages]
    if seeds:
        loaded = load_policy(training.checkpoints / "last" / "pretrained_model")
        env_config = environment(loaded.policy.config)
        for first in range(0, len(seeds), N_ENVS):
            group = seeds[first : first + N_ENVS]
            acted = {each.seed: how_far(each) for each in act(loaded, env_config, group)}
            stages |= dict.fromkeys(group, 0) | acted
            path.write_text(json.dumps(stages))
    return Cell(name, training.facts, stages)


def environment(config: Any) -> SeldomRenderedConfig:
    """The environment that a policy was trained in."""
    from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment

    usual = environment_of(config, task_environment(TASK, "touch"))
    return SeldomRenderedConfig(**{each.name: getattr(usual, each.name) for each in fields(usual)})


def how_far(episode: "Rollout") -> int:
    """How far an episode came.

    Raises:
        RuntimeError: the policy looked when nothing was rendered.
    """
    if late := [each.step for each in episode.inferences if each.step % LOOKS]:
        raise RuntimeError(f"the policy looked at steps {late}, rendered is every {LOOKS}th")
    return int(episode.rewards.max())


def show(cells: list[Cell], console: Console) -> None:
    """The table."""
    table = Table("policy", "steps", "CPU min", "parameters", "success", *STAGES)
    for cell in cells:
        count, train = Counter(cell.stages.values()), cell.train
        numbers = (str(train["steps"]), f"{train['cpu_minutes']:.1f}", f"{train['parameters']:,}")
        table.add_row(cell.policy, *numbers, str(cell.rate), *(str(count[i]) for i in range(len(STAGES))))
    console.print(table)


def main() -> None:
    """Everything."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--policies", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--folder", type=Path, default=Path("outputs/benchmarks/vqbet_pixels"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/vqbet_pixels.json"))
    args = parser.parse_args()
    console = Console(width=160)
    recording, cells = record(args.folder, console), []
    for name in args.policies:
        training = Training(args.folder / VARIANTS[name].policy["type"], VARIANTS[name], 0, recording)
        training.train(console)
        cells.append(evaluate(name, training, args.episodes))
    show(cells, console)
    args.out.write_text(json.dumps([asdict(cell) for cell in cells], indent=1) + "\n")


if __name__ == "__main__":
    main()
