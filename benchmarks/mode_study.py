"""Which policies take the ways that were demonstrated, as often; and what repairs those that do not.

    OMP_NUM_THREADS=1 nice -n 5 python benchmarks/mode_study.py

records `three_gates` in the proportions 80/15/5 and equally, trains small networks of every policy type with
several likelihoods and latents, asks `act-chunking modes` about each before and after its fix, and writes
benchmarks/results/mode_study.json, and the table and the picture of docs/instruments/modes.md. One training
seed. What is done is kept in --folder: the same command goes on where it was.
"""

import argparse
import json
import resource
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from lerobot_act_chunking.compat import trackers_off
from lerobot_act_chunking.durable_files import write_atomically

ROOT = Path(__file__).parents[1]
RESULTS, PAGE = ROOT / "benchmarks/results/mode_study.json", ROOT / "docs/instruments/modes.md"
IMAGE, TRAINING = ROOT / "docs/images/modes.png", "training.json"
MARK, END = "<!-- modes: python benchmarks/mode_study.py -->", "<!-- end -->"
SHARES = {"80/15/5": ("--mode-shares", "80,15,5"), "equal": ()}
DEMONSTRATIONS, CHUNK, BATCH = 200, 20, 64
COMMON = {"device": "cpu", "push_to_hub": "false", "optimizer_lr": 1e-3, "lr_warmup_steps": 50}
ACT = {
    "type": "act_chunked",
    "chunk_size": CHUNK,
    "dim_model": 64,
    "n_heads": 4,
    "dim_feedforward": 128,
    "n_encoder_layers": 2,
}
LATENT = {
    **ACT,
    "use_vae": "true",
    "z_inference": "sample",
    "kl_weight": 0.01,
    "latent_dim": 4,
    "latent_warmup_steps": 150,
}
VQBET = {
    "type": "vqbet_chunked",
    "chunk_size": CHUNK,
    "n_vqvae_training_steps": 200,
    "gpt_hidden_dim": 64,
    "gpt_n_layer": 2,
    "gpt_n_head": 4,
    "head_hidden_dims": "[128]",
}
DIFFUSION = {"type": "diffusion_chunked", "horizon": CHUNK, "dim_model": 64, "n_heads": 4}


@dataclass(frozen=True)
class Learner:
    """A policy with its settings, and those that the fix adds to `BALANCED`."""

    settings: dict[str, Any]
    fix: dict[str, Any] = field(default_factory=dict)
    steps: int = 600


LEARNERS = {
    "act_chunked, l1": Learner(ACT),
    "act_chunked, gmm": Learner({**ACT, "action_likelihood": "gmm", "action_temperature": 1}),
    "act_chunked, categorical bins": Learner(
        {
            **ACT,
            "action_likelihood": "categorical",
            "action_temperature": 1,
            "normalization_mapping": "{ACTION: MIN_MAX}",
        }
    ),
    "act_chunked, gaussian latent, kl_weight=10": Learner({**LATENT, "kl_weight": 10}, {"kl_weight": 0.01}),
    "act_chunked, gaussian latent": Learner(LATENT),
    "act_chunked, mixture latent": Learner({**LATENT, "latent_type": "mixture"}),
    "act_chunked, categorical latent": Learner({**LATENT, "latent_type": "categorical"}),
    "vqbet_chunked": Learner(VQBET, {"top_p": 1}, steps=900),
    "diffusion_chunked": Learner(DIFFUSION),
}
BALANCED = {"balance_modes": "labels"}
GAUSSIAN = "act_chunked, gaussian latent"


@dataclass(frozen=True)
class Cell:
    """A policy on a recording, as it is, balanced, or with a prior fitted after training."""

    shares: str
    learner: str
    fix: str = "none"

    @property
    def place(self) -> Path:
        words = (self.shares, self.learner, self.fix)
        return Path("_".join(words).replace("/", "-").replace(", ", "_").replace(" ", "-"))


PICTURED = Cell(next(iter(SHARES)), GAUSSIAN)


def cells() -> Iterator[Cell]:
    """All, those of the uneven proportions first."""
    first, *others = SHARES
    for learner in LEARNERS:
        yield Cell(first, learner)
        if learner == GAUSSIAN:
            yield Cell(first, learner, "fit-prior")
        if "kl_weight" not in learner:
            yield Cell(first, learner, "balanced")
        if learner == GAUSSIAN:
            yield Cell(first, learner, "balanced, fit-prior")
    for shares in others:
        yield from (Cell(shares, learner) for learner in LEARNERS if "kl_weight" not in learner)


@dataclass(frozen=True)
class Study:
    """Where everything is kept."""

    folder: Path
    episodes: int

    def record(self, shares: str) -> Path:
        """The demonstrations, recorded if they are not there."""
        dataset = self.folder / f"gates_{shares.replace('/', '_')}"
        if not (dataset / "meta/info.json").exists():
            noise = ("--waypoint-noise", "0.01", "--episodes", str(DEMONSTRATIONS))
            place = ("--repo-id", "local/gates", "--root", str(dataset))
            act_chunking("record", "--env", "three_gates", *SHARES[shares], *noise, *place)
        return dataset

    def checkpoint(self, cell: Cell) -> Path:
        """The policy, trained or fitted if it is not there."""
        if "fit-prior" in cell.fix:
            balanced = "balanced" in cell.fix
            fitted, weights = self.folder / cell.place, "uniform" if balanced else "empirical"
            if not fitted.exists():
                trained = Cell(cell.shares, cell.learner, "balanced" if balanced else "none")
                source, dataset = str(self.checkpoint(trained)), str(self.record(cell.shares))
                act_chunking(
                    "fit-prior", source, dataset, "--out", str(fitted), "--component-weights", weights
                )
            return fitted
        learner = LEARNERS[cell.learner]
        output = self.folder / cell.place
        found = output / f"checkpoints/{learner.steps:06d}/pretrained_model"
        if not (found / "model.safetensors").exists():
            fix = {**BALANCED, **learner.fix} if cell.fix == "balanced" else {}
            dataset, started = self.record(cell.shares), cpu_seconds()
            train({**COMMON, **learner.settings, **fix}, learner.steps, dataset, output)
            (output / TRAINING).write_text(json.dumps({"cpu_s": round(cpu_seconds() - started, 1)}))
        return found

    def result(self, cell: Cell) -> Path:
        """Where that is kept."""
        return self.folder / f"{cell.place}.json"

    def measure(self, cell: Cell) -> dict[str, Any]:
        """What ``act-chunking modes`` says of the policy."""
        found = self.result(cell)
        if not found.exists():
            checkpoint = str(self.checkpoint(cell))
            training = self.folder / cell.place / TRAINING
            seconds = json.loads(training.read_text())["cpu_s"] if training.exists() else None
            asked = ("--env.type=three_gates", f"--episodes={self.episodes}")
            draft, picture = found.with_suffix(".part"), found.with_suffix(".png")
            act_chunking("modes", checkpoint, *asked, "--json", str(draft), "--out", str(picture))
            tried = {
                "shares": cell.shares,
                "learner": cell.learner,
                "fix_tried": cell.fix,
                "training_seed": 0,
            }
            content = {**tried, "training_cpu_s": seconds, **json.loads(draft.read_text())}
            content |= {"checkpoint": cell.place.name, "dataset": Path(content["dataset"]).name}
            write_atomically(found, json.dumps(content).encode())
        return json.loads(found.read_text())


def act_chunking(*arguments: str) -> None:
    """The command, in this process: importing everything anew takes longer than what it does."""
    from lerobot_act_chunking.cli.main import main as command

    if command(list(arguments)) not in (0, 10, 11):
        sys.exit(f"act-chunking {' '.join(arguments)} failed")


def train(settings: dict[str, Any], steps: int, dataset: Path, output: Path) -> None:
    """As ``lerobot-train`` does; what was interrupted begins again."""
    import shutil

    from lerobot.scripts import lerobot_train

    shutil.rmtree(output, ignore_errors=True)
    sys.argv = [
        "lerobot-train",
        *(f"--policy.{name}={value}" for name, value in settings.items()),
        *("--dataset.repo_id=local/gates", f"--dataset.root={dataset}", f"--output_dir={output}"),
        *(f"--steps={steps}", f"--save_freq={steps}", f"--log_freq={steps}", f"--batch_size={BATCH}"),
        *("--seed=0", "--num_workers=0", "--env_eval_freq=0", *trackers_off()),
    ]
    lerobot_train.main()


def cpu_seconds() -> float:
    """Of this process, so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def row(result: dict[str, Any]) -> list[str]:
    """A result for people."""

    def told(found: dict[str, Any] | None) -> str:
        if found is None:
            return "-"
        shares = "/".join(f"{100 * share:.0f}" for share in found["shares"])
        return f"{shares}, {100 * found['invalid_share']:.0f}"

    covered = len(result["proportions"]) - len(result["episodes"]["missing"])
    cause = "" if result["cause"] == "none" else result["cause"]
    of_chunks = told(result["chunks"])
    fix = "" if result["fix_tried"] == "none" else result["fix_tried"]
    return [
        *(result["shares"], result["learner"], fix, told(result["episodes"]), of_chunks),
        *(f"{covered} of {len(result['proportions'])}", result["verdict"], cause),
    ]


COLUMNS = (
    "demonstrated %",
    "policy",
    "repair",
    "episodes %, invalid",
    "chunks %, invalid",
    "covered",
    "verdict",
    "cause",
)


def table(results: list[dict[str, Any]]) -> str:
    """All results in Markdown."""
    rows = [list(COLUMNS), ["---"] * len(COLUMNS), *map(row, results)]
    return "\n".join(f"| {' | '.join(each)} |" for each in rows)


def with_table(page: str, mark: str, shown: str) -> str:
    """The page with a table between its mark and the next end."""
    before, rest = page.split(mark)
    return f"{before}{mark}\n{shown}\n{END}{rest.split(END, 1)[1]}"


def show_on(page: Path, mark: str, shown: str) -> None:
    """Write a table into a page."""
    write_atomically(page, with_table(page.read_text(), mark, shown).encode())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=ROOT / "outputs/mode_study")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--shares", nargs="+", choices=SHARES, default=list(SHARES))
    parser.add_argument("--learners", nargs="+", choices=LEARNERS, default=list(LEARNERS))
    arguments = parser.parse_args()
    study = Study(arguments.folder, arguments.episodes)
    study.folder.mkdir(parents=True, exist_ok=True)
    asked = [
        each for each in cells() if each.shares in arguments.shares and each.learner in arguments.learners
    ]
    for cell in asked:
        study.measure(cell)
    done = [study.measure(cell) for cell in cells() if study.result(cell).exists()]
    shown = Table(*COLUMNS, box=None, pad_edge=False)
    for each in done:
        shown.add_row(*row(each))
    Console(width=160).print(shown)
    write_atomically(RESULTS, (json.dumps(done, indent=1) + "\n").encode())
    show_on(PAGE, MARK, table(done))
    picture = study.result(PICTURED).with_suffix(".png")
    if picture.exists():
        write_atomically(IMAGE, picture.read_bytes())


if __name__ == "__main__":
    main()
