"""Are episodes the same whoever runs them, and how much faster are two workers than one?

    python benchmarks/executors.py [--episodes 12] [--rounds 3] [--out benchmarks/results/executors.json]
    python benchmarks/executors.py --table

With processes of this machine and with a Ray of this machine: scripted transfers are recorded by one worker
and by two, in turn, with a camera and without (five times as many); then with a camera by two, one of which
is killed (SIGKILL) in the middle; and a policy is evaluated that was never trained and draws noise. Datasets
are compared file by file, evaluations number by number, commands and states of every step included. Times
leave out the start of Ray and a first recording, which imports LeRobot. Writes the result, and its table into
docs/guides/cluster.md.
"""

import argparse
import json
import os
import platform
import signal
import statistics
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import lerobot_act_chunking as ac
from lerobot_act_chunking.executors import Cluster
from lerobot_act_chunking.recording import RecordingProgress, RecordSpec, record

# Worker processes import this file as well: what is heavy is imported where it is used.
ROOT = Path(__file__).parents[1]
PAGE, RESULTS = ROOT / "docs/guides/cluster.md", ROOT / "benchmarks/results/executors.json"
BEGIN, END = "<!-- executors: python benchmarks/executors.py -->\n", "<!-- end -->"
EXECUTORS = {"local": None, "ray": Cluster()}
TASK, STEPS, EVALUATED = "transfer_cube", 60, 12
CAMERA, STATE = "one camera, 240 x 320", "no camera"
OPTIONS = {
    CAMERA: {"obs": "pixels_state", "image_height": 240, "image_width": 320, "render_quality": "fast"},
    STATE: {},
}
CHEAPER = 5  # times as many episodes without a camera


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=12, help="of a recording with a camera")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--table", action="store_true", help="only write the table anew")
    args = parser.parse_args()
    if not args.table:
        with tempfile.TemporaryDirectory() as folder:
            result = measure(Path(folder), args.episodes, args.rounds)
        args.out.write_text(json.dumps(result, indent=1) + "\n")
    PAGE.write_text(with_table(PAGE.read_text(), json.loads(args.out.read_text())))


def measure(folder: Path, episodes: int, rounds: int) -> dict[str, Any]:
    """Everything, in a folder of its own."""
    EXECUTORS["ray"].connect(2)
    checkpoint = untrained(folder / "policy")
    alone, *others = [evaluated(folder / f"eval_{name}", checkpoint, name) for name in ("alone", *EXECUTORS)]
    played(folder / "first", CAMERA, 1, "local", 1)
    seconds: dict[str, dict[str, dict[str, list[float]]]] = {
        kind: {each: {"1": [], "2": []} for each in EXECUTORS} for kind in OPTIONS
    }
    recordings: dict[str, list[Path]] = {kind: [] for kind in OPTIONS}
    several = {CAMERA: episodes, STATE: CHEAPER * episodes}
    order = [(kind, name, n) for kind in OPTIONS for n in (1, 2) for name in EXECUTORS]
    for turn in range(rounds):
        for at, (kind, name, workers) in enumerate(order):
            root = folder / f"{turn}_{at}"
            recordings[kind].append(root)
            seconds[kind][name][str(workers)].append(played(root, kind, several[kind], name, workers))
    expected = {kind: files(roots[0]) for kind, roots in recordings.items()}
    killed = {}
    for name in EXECUTORS:
        died: list[int] = []
        root = folder / f"{name}_killed"
        played(root, CAMERA, episodes, name, 2, killing(died, episodes // 3))
        killed[name] = {"died": len(died), "same": files(root) == expected[CAMERA]}
    return {
        "seconds": seconds,
        "same": all(files(each) == expected[kind] for kind in OPTIONS for each in recordings[kind]),
        "killed": killed,
        "eval_same": {name: other == alone for name, other in zip(EXECUTORS, others, strict=True)},
        "episodes": several,
        "evaluated": EVALUATED,
        "machine": {"cores": os.cpu_count(), "load": os.getloadavg()[1], "system": platform.platform()},
        "versions": {name: version(name) for name in ("ray", "lerobot", "mujoco", "numpy", "torch")},
    }


def played(
    root: Path,
    kind: str,
    episodes: int,
    name: str,
    workers: int,
    progress: Callable[[RecordingProgress], None] = lambda _: None,
) -> float:
    """Record; how long it took [s]."""
    options: dict[str, Any] = {**OPTIONS[kind], "workers": workers, "cluster": EXECUTORS[name]}
    spec = RecordSpec("local/cube", root, task=TASK, episodes=episodes, **options)
    started = time.perf_counter()
    record(spec, progress=progress)
    return time.perf_counter() - started


def killing(died: list[int], after: int) -> Callable[[RecordingProgress], None]:
    """Kills a worker once, after so many episodes."""

    def kill(progress: RecordingProgress) -> None:
        if progress.recorded == after and not died:
            died.append(workers_of_this_process()[0])
            os.kill(died[0], signal.SIGKILL)

    return kill


def workers_of_this_process() -> list[int]:
    """Process ids of workers, of both kinds, that descend from this process."""
    parents, commands = {}, {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            commands[int(folder.name)] = (folder / "cmdline").read_bytes()
        except OSError:  # it has ended
            continue
    ours = {os.getpid()}
    for _ in range(5):
        ours |= {pid for pid, parent in parents.items() if parent in ours}
    return [
        pid
        for pid in sorted(ours & commands.keys())
        if any(word in commands[pid] for word in (b"spawn_main", b"ray::_Actor"))
    ]


def files(root: Path) -> dict[str, bytes]:
    """Everything in a dataset."""
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def untrained(folder: Path) -> str:
    """A checkpoint of a policy that moves about the start and draws noise."""
    import torch
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors

    from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig

    environment = AlohaSimEnvConfig(obs_type="state", task=TASK)
    features = {environment.features_map[name]: each for name, each in environment.features.items()}
    inputs = {name: each for name, each in features.items() if name != "action"}
    config = ac.DiffusionChunkedConfig(
        device="cpu", push_to_hub=False, input_features=inputs, output_features={"action": features["action"]}
    )
    torch.manual_seed(0)
    stats = {
        name: {"mean": torch.zeros(each.shape), "std": torch.full(each.shape, 0.3)}
        for name, each in features.items()
    }
    for part in (
        get_policy_class(config.type)(config),
        *make_pre_post_processors(config, dataset_stats=stats),
    ):
        part.save_pretrained(folder)
    return str(folder)


def evaluated(folder: Path, checkpoint: str, name: str) -> list[Any]:
    """Every number of an evaluation but times: its ``eval_info.json``, commands and states."""
    from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
    from lerobot_act_chunking.diagnostics.core.recipes import Recipe
    from lerobot_act_chunking.diagnostics.eval.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.eval.settings import Settings

    environment = EnvironmentSpec("aloha_sim", {"obs_type": "state", "task": TASK, "episode_length": STEPS})
    report = diagnose(
        Settings(
            (Recipe("policy", (checkpoint,)),),
            environment,
            episodes=EVALUATED,
            batch_size=4,
            workers=1 if name == "alone" else 2,
            cluster=EXECUTORS.get(name),
            output_dir=folder,
        )
    )
    (result,) = report.results
    motion = [
        result.run.motion(*divmod(place, 4), kind).tolist()
        for place in range(EVALUATED)
        for kind in ("commands", "states")
    ]
    info = json.loads((folder / "policy" / "eval_info.json").read_text())
    assert np.ptp(motion[0]) > 0
    return [info, motion]


def with_table(page: str, result: dict[str, Any]) -> str:
    """The page with the table of this result."""
    begin, end = page.index(BEGIN) + len(BEGIN), page.index(END)
    return page[:begin] + table(result) + page[end:]


def table(result: dict[str, Any]) -> str:
    """Times and equality, a row for each executor."""
    rows = [
        "",
        "| episodes | `--executor` | one worker [s] | two [s] | ratio | one killed: same | same `eval` |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind, name in [(kind, name) for kind in result["seconds"] for name in EXECUTORS]:
        seconds = result["seconds"][kind][name]
        one, two = (statistics.median(seconds[workers]) for workers in ("1", "2"))
        ratios = [a / b for a, b in zip(seconds["1"], seconds["2"], strict=True)]
        faster = f"{statistics.median(ratios):.2f} ({min(ratios):.2f}-{max(ratios):.2f})"
        same = "-" if kind == STATE else said(result["killed"][name] == {"died": 1, "same": True})
        evaluated = "-" if kind == CAMERA else said(result["eval_same"][name])
        episodes = f"{result['episodes'][kind]}, {kind}"
        rows.append(f"| {episodes} | `{name}` | {one:.1f} | {two:.1f} | {faster} | {same} | {evaluated} |")
    return "\n".join([*rows, "", ""])


def said(yes: bool) -> str:
    return "yes" if yes else "no"


if __name__ == "__main__":
    main()
