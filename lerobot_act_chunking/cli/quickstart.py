"""``act-chunking quickstart``: the whole plan with the real commands, each printed so that it can be copied.

Every stage leaves a result on disk and is skipped when that result is there, so the plan can be stopped at
any moment and run again.
"""

import json
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.rule import Rule

from lerobot_act_chunking.compat import trackers_off
from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.errors import ActChunkingError, ConfigurationError, unknown_choice
from lerobot_act_chunking.json_files import read_json

TASKS = ("transfer_cube", "insertion")
LOCAL_HUB = "LEROBOT_LOCAL_HUB"

# The recipe of configs/quickstart.yaml (a test holds the two together); measured in the README.
POLICY = {
    "type": "act_chunked",
    "device": "cpu",
    "chunk_size": "100",
    "actions_per_query": "5",
    "dim_model": "128",
    "n_heads": "4",
    "n_encoder_layers": "2",
    "dropout": "0",
    "optimizer_lr": "1e-3",
    "lr_warmup_steps": "200",
}


class StageFailedError(ActChunkingError):
    """A command of the plan ended with an error."""


@dataclass(frozen=True)
class QuickstartPlan:
    """What the quickstart does: where, with how much data and how long."""

    folder: Path
    task: str = "transfer_cube"
    episodes: int = 50
    steps: int = 4000
    eval_episodes: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        if self.task not in TASKS:
            raise unknown_choice("task", self.task, TASKS)

    @property
    def dataset(self) -> Path:
        """Root of the recorded LeRobotDataset."""
        return self.folder / "dataset"

    @property
    def repo_id(self) -> str:
        """Name of the dataset; nothing is ever looked up under it."""
        return f"local/{self.task}"

    @property
    def hub(self) -> Path:
        """The folder that takes the Hugging Face Hub's place: the user's own, or one beside the results."""
        return Path(os.environ.get(LOCAL_HUB) or self.folder / "hub").resolve()

    @property
    def policy_repo_id(self) -> str:
        """Name of the trained policy in the hub."""
        return f"local/act_{self.task}"

    @property
    def train(self) -> Path:
        """Output folder of lerobot-train."""
        return self.folder / "train"

    @property
    def checkpoint(self) -> Path:
        """The newest checkpoint, as LeRobot lays it out."""
        return self.train / "checkpoints" / "last" / "pretrained_model"

    @property
    def evaluation(self) -> Path:
        """Output folder of lerobot-eval."""
        return self.folder / "eval"

    @property
    def picture(self) -> Path:
        """The picture of one episode's motion."""
        return self.folder / "motion.png"

    def record_command(self) -> list[str]:
        """Scripted demonstrations into a LeRobotDataset."""
        return [
            *(
                "act-chunking",
                "record",
                "--task",
                self.task,
                "--episodes",
                str(self.episodes),
                "--obs",
                "state",
            ),
            *(
                "--repo-id",
                self.repo_id,
                "--root",
                str(self.dataset),
                "--workers",
                str(min(2, os.cpu_count() or 1)),
            ),
        ]

    def train_command(self) -> list[str]:
        """LeRobot's own training, from scratch or from where it was stopped."""
        if self.checkpoint.exists():
            return ["lerobot-train", f"--config_path={self.checkpoint}/train_config.json", "--resume=true"]
        return [
            "lerobot-train",
            *(f"--policy.{name}={value}" for name, value in POLICY.items()),
            *("--policy.push_to_hub=true", f"--policy.repo_id={self.policy_repo_id}"),
            f"--dataset.repo_id={self.repo_id}",
            f"--dataset.root={self.dataset}",
            f"--output_dir={self.train}",
            f"--seed={self.seed}",
            f"--steps={self.steps}",
            f"--save_freq={max(1, self.steps // 5)}",
            f"--log_freq={max(1, min(200, self.steps // 10))}",
            "--batch_size=64",
            "--num_workers=0",
            "--env_eval_freq=0",
            *trackers_off(),
        ]

    def eval_command(self, policy_path: str | None = None) -> list[str]:
        """LeRobot's own evaluation, on poses no demonstration has; by default of what was pushed."""
        return [
            "lerobot-eval",
            f"--policy.path={policy_path or self.policy_repo_id}",
            "--policy.device=cpu",
            *("--env.type=aloha_sim", f"--env.task={self.task}", "--env.obs_type=state"),
            *("--env.render_quality=fast", "--env.visualization_width=320", "--env.visualization_height=240"),
            f"--eval.n_episodes={self.eval_episodes}",
            f"--eval.batch_size={min(50, self.eval_episodes)}",
            "--eval.use_async_envs=false",
            "--seed=1000",
            f"--output_dir={self.evaluation}",
        ]

    def motion_command(self) -> list[str]:
        """One episode as a picture."""
        return [
            "act-chunking",
            "motion",
            self.policy_repo_id,
            "--task",
            self.task,
            "--out",
            str(self.picture),
        ]

    def recorded(self) -> bool:
        """The recorder publishes the dataset in one step, so that it is there or it is not."""
        return (self.dataset / "meta" / "info.json").exists()

    def trained(self) -> bool:
        """Whether the last step's policy reached the hub, which is what lerobot-train does last."""
        checkpoint = self.train / "checkpoints" / f"{self.steps:06d}"
        pushed = self.hub / f"models--{self.policy_repo_id.replace('/', '--')}" / "refs" / "main"
        return checkpoint.exists() and pushed.exists()

    def evaluated(self) -> bool:
        """Whether lerobot-eval finished."""
        return (self.evaluation / "eval_info.json").exists()

    def drawn(self) -> bool:
        """Whether the picture exists."""
        return self.picture.exists()


def quickstart_command(
    output_dir: Annotated[Path, typer.Option(help="Where everything goes.")] = Path("outputs/quickstart"),
    task: Annotated[str, typer.Option(help="transfer_cube or insertion.")] = "transfer_cube",
    episodes: Annotated[int, typer.Option(min=1, help="Demonstrations to record.")] = 50,
    steps: Annotated[int, typer.Option(min=1, help="Training steps.")] = QuickstartPlan.steps,
    eval_episodes: Annotated[int, typer.Option(min=1, help="Episodes to evaluate.")] = 200,
    seed: Annotated[int, typer.Option(help="Training seed.")] = 0,
) -> None:
    """Record demonstrations, train, evaluate and draw, with LeRobot's own commands, offline.

    Stop it whenever you like: the same command goes on where it was.
    """
    plan = QuickstartPlan(output_dir, task, episodes, steps, eval_episodes, seed)
    claim_folder(plan)
    console = Console()
    started = time.monotonic()
    stages: list[tuple[str, Callable[[], bool], Callable[[], list[str]]]] = [
        ("1/4 record demonstrations", plan.recorded, plan.record_command),
        ("2/4 train", plan.trained, lambda: train_afresh_or_on(plan)),
        ("3/4 evaluate on unseen poses", plan.evaluated, plan.eval_command),
        ("4/4 draw one episode", plan.drawn, plan.motion_command),
    ]
    os.environ[LOCAL_HUB] = str(plan.hub)
    console.print(f"$ export {LOCAL_HUB}={plan.hub}", highlight=False, soft_wrap=True, style="bold")
    for title, done, command in stages:
        console.print(Rule(title))
        if done():
            console.print("already done")
        else:
            run(command(), console)
    _conclude(plan, console, time.monotonic() - started)


def claim_folder(plan: QuickstartPlan) -> None:
    """Note in the folder which plan it holds, so that results of another one never pass for this one's.

    Raises:
        ConfigurationError: the folder holds a plan with other settings.
    """
    settings = {name: value for name, value in asdict(plan).items() if name != "folder"}
    note = plan.folder / "quickstart.json"
    if note.exists():
        try:
            held = dict(read_json(note))
        except (ValueError, TypeError) as error:
            raise ConfigurationError(
                f"{note} is damaged ({error}): with the settings of that quickstart, remove the file and "
                "repeat the command to go on; otherwise give another --output-dir"
            ) from error
        differing = [f"{name}={held.get(name)}" for name in settings if held.get(name) != settings[name]]
        if differing:
            raise ConfigurationError(
                f"{plan.folder} holds a quickstart with {', '.join(differing)}; "
                "repeat those settings to go on with it, or give another --output-dir"
            )
        return
    write_atomically(note, (json.dumps(settings, indent=2) + "\n").encode())


def run(command: list[str], console: Console) -> None:
    """Print a command for copying, then run it with the scripts of this very environment.

    Raises:
        StageFailedError: it ended with an error; its own output says which.
        KeyboardInterrupt: the user stopped it.
    """
    console.print(f"$ {shlex.join(command)}", highlight=False, soft_wrap=True, style="bold")
    script = shutil.which(command[0], path=str(Path(sys.executable).parent)) or command[0]
    status = subprocess.run([script, *command[1:]], check=False).returncode  # noqa: S603  (our own commands)
    if status in (130, -2):
        raise KeyboardInterrupt
    if status != 0:
        raise StageFailedError(f"{command[0]} ended with status {status}; its output above says why")


def train_afresh_or_on(plan: QuickstartPlan) -> list[str]:
    """The training command; a folder without a checkpoint, which lerobot-train would refuse, is removed."""
    if plan.train.exists() and not plan.checkpoint.exists():
        shutil.rmtree(plan.train)
    return plan.train_command()


def _conclude(plan: QuickstartPlan, console: Console, seconds: float) -> None:
    from lerobot_act_chunking.diagnostics.core.eval_info import read_success_rate

    console.print(Rule("result"))
    console.print(f"success: {read_success_rate(plan.evaluation / 'eval_info.json')}")
    videos = sorted(plan.evaluation.rglob("*.mp4"))
    for label, path in [
        ("policy", plan.checkpoint),
        ("picture", plan.picture),
        *(("video", v) for v in videos[:1]),
    ]:
        console.print(f"{label}: {path}", soft_wrap=True)
    console.print(f"time: {seconds / 60:.1f} minutes")
