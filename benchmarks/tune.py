"""Does `act-chunking tune` mend a badly set checkpoint, and in how many minutes?

Sets the execution of a trained checkpoint badly (a copy of it), tunes that, and then evaluates on seeds that
tuning did not see: the bad settings, the choice, and every candidate, of which the best is the yardstick.

    python benchmarks/tune.py CHECKPOINT --task insertion --bad '{"execution": "open_loop"}'
"""

import argparse
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.diagnosis import diagnose
from lerobot_act_chunking.diagnostics.tune.measuring import Episodes, make_runner
from lerobot_act_chunking.diagnostics.tune.racing import Cell
from lerobot_act_chunking.diagnostics.tune.settings import Settings
from lerobot_act_chunking.diagnostics.tune.subject import Subject, read_subject
from lerobot_act_chunking.executors import Cluster, each_done

FIRST_SEED = 1000
AT_ONCE = 50


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--task", required=True)
    parser.add_argument("--bad", type=json.loads, required=True, help="fields of its configuration, as JSON")
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--address", type=Cluster, help="of a Ray cluster whose workers they are")
    parser.add_argument("--episodes", type=int, default=100, help="of each candidate's evaluation")
    parser.add_argument("--output", type=Path, help="a JSON file")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        copy = badly_set(args.checkpoint, Path(scratch) / "checkpoint", args.bad)
        result = measure(str(copy), Path(scratch) / "episodes", args)
    print(json.dumps(result, indent=1))
    if args.output is not None:
        args.output.write_text(json.dumps(result, indent=1) + "\n")


def badly_set(checkpoint: Path, copy: Path, bad: dict[str, object]) -> Path:
    """A copy of a checkpoint with other values in its configuration."""
    shutil.copytree(checkpoint, copy)
    config = json.loads((copy / "config.json").read_text())
    (copy / "config.json").write_text(json.dumps({**config, **bad}, indent=4))
    return copy


def measure(checkpoint: str, folder: Path, args: argparse.Namespace) -> dict[str, object]:
    """Tune, then evaluate all candidates."""
    workers: dict[str, Any] = {"workers": args.workers, "cluster": args.address}
    settings = Settings(
        checkpoint, task_environment(args.task), minutes=args.minutes, output_dir=folder, **workers
    )
    report = diagnose(settings)
    subject = read_subject(checkpoint)
    rates = evaluate(subject, args.task, args.episodes, **workers)
    best = max(rates, key=lambda each: rates[each].rate)
    chosen = report.judgement.chosen
    return {
        "task": args.task,
        "policy_type": report.policy_type,
        "bad": args.bad,
        "minutes": report.minutes,
        "workers": args.workers,
        "tuning_episodes": report.race.n_episodes if report.race else None,
        "verdict": report.verdict,
        "reasons": report.reasons,
        "present": described(subject.present, rates),
        "chosen": described(chosen, rates),
        "best": described(best, rates),
        "recovered": rates[chosen].rate / rates[best].rate if rates[best].successes else None,
        "evaluation": [described(each, rates) for each in subject.candidates],
    }


def evaluate(
    subject: Subject, task: str, episodes: int, workers: int, cluster: Cluster | None
) -> dict[Candidate, SuccessRate]:
    """Success of every candidate on the seeds from 1000 on."""
    policy = subject.load()
    env_config = environment_of(subject.config, task_environment(task), subject.checkpoint)
    spans = [(at, min(AT_ONCE, episodes - at)) for at in range(0, episodes, AT_ONCE)]
    cells = [Cell(each, *span) for each in subject.candidates for span in spans]
    successes = dict.fromkeys(subject.candidates, 0)
    with make_runner(Episodes(subject, env_config, FIRST_SEED), workers, policy, cluster) as runner:
        for cell, outcome in each_done(runner, cells):
            successes[cell.candidate] += sum(outcome)
    return {each: SuccessRate(n, episodes) for each, n in successes.items()}


def described(candidate: Candidate, rates: dict[Candidate, SuccessRate]) -> dict[str, object]:
    """A candidate with its success."""
    rate = rates[candidate]
    return {"candidate": str(candidate), "successes": rate.successes, "episodes": rate.episodes}


if __name__ == "__main__":
    main()
