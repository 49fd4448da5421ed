"""An exported policy beside the one in PyTorch: differences, times, memory, and success on the same seeds.

    MUJOCO_GL=egl python benchmarks/export.py

records 50 demonstrations of ten scripted people, trains `act_chunked` on them for 1500 steps, exports it, and
lets both act in the same 200 episodes of `transfer_cube`; exports the three policy types as they come, with
random weights, and times a new chunk of each, in turns, one thread each, in CPU time; starts a process for
each runtime and asks what it took (Linux). It writes benchmarks/results/export.json and the tables of
docs/guides/export.md. What is recorded, trained and exported is kept in --folder; --parts measures a part.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mode_study import ROOT, show_on
from operators import PEOPLE
from policy_training import Recording, Training, Variant
from rich.console import Console

from act_chunking_runtime.draws import Draws
from act_chunking_runtime.policy import ExportedPolicy
from act_chunking_runtime.policy import load as load_exported
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.durable_files import write_atomically

RESULTS, PAGE = ROOT / "benchmarks/results/export.json", ROOT / "docs/guides/export.md"
CHUNKS = "<!-- chunks: python benchmarks/export.py -->"
PROCESSES = "<!-- processes: python benchmarks/export.py -->"
CPU = {"device": "cpu", "push_to_hub": False}
TRAINED = Variant({"type": "act_chunked", **CPU}, 1500, 64)
FIRST_SEED, EPISODES = 100_000, 200
STATE, CAMERA = {"state": (14,), "environment_state": (7,)}, {"state": (14,), "images.top": (3, 240, 320)}
CAMERA_POLICY = {"vision_backbone": "resnet18", "pretrained_backbone_weights": None}
POLICIES: dict[str, tuple[str, dict[str, tuple[int, ...]], dict[str, Any]]] = {
    "act_chunked": ("act_chunked", STATE, {}),
    "act_chunked, one camera": ("act_chunked", CAMERA, CAMERA_POLICY),
    "diffusion_chunked": ("diffusion_chunked", STATE, {}),
    "vqbet_chunked": ("vqbet_chunked", STATE, {}),
}
PARTS = ("chunks", "processes", "episodes")
NAMES = {"observation.state": "agent_pos", "observation.environment_state": "environment_state"}
FOLLOWED = 5  # episodes
WINDOWS = 20  # whose chunks are compared
START = {
    "act_chunking_runtime": (
        "from act_chunking_runtime.policy import load; import numpy as np",
        "policy = load(folder, np.random.default_rng(0))",
    ),
    "lerobot_act_chunking": (
        "import torch; torch.set_num_threads(1); "
        "from lerobot_act_chunking.policies.loading import load_policy",
        "policy = load_policy(folder)",
    ),
}
PROCESS = """
import json, sys, time
folder, observation = sys.argv[1], json.loads(sys.argv[2])
begin = time.process_time()
{imports}
{load}
loaded = time.process_time() - begin
import numpy as np
policy.reset()
policy.act({{key: np.array(value, dtype=np.float32) for key, value in observation.items()}})
print(json.dumps({{
    "seconds": loaded,
    "memory_mb": int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0]) / 1024,
    "has": sorted({{"torch", "lerobot"}} & set(sys.modules)),
}}))
"""


def planted(kind: str, inputs: dict[str, tuple[int, ...]], settings: dict[str, Any]) -> Any:
    """A policy with random weights and the processors of planted statistics."""
    import torch
    from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors
    from lerobot.utils.import_utils import register_third_party_plugins

    from lerobot_act_chunking.policies.loading import LoadedPolicy

    register_third_party_plugins()
    torch.manual_seed(0)
    kinds = {"state": FeatureType.STATE, "environment_state": FeatureType.ENV}
    features = {
        f"observation.{key}": PolicyFeature(kinds.get(key, FeatureType.VISUAL), shape)
        for key, shape in inputs.items()
    }
    actions = {"action": PolicyFeature(FeatureType.ACTION, (14,))}
    config: Any = PreTrainedConfig.get_choice_class(kind)(
        input_features=features, output_features=actions, **CPU, **settings
    )
    policy = get_policy_class(kind)(config).eval()
    if kind == "vqbet_chunked":
        policy.tokenizer_phase.n_learned.fill_(policy.tokenizer_phase.n_steps)
    stats = {key: statistics_of(each.shape) for key, each in {**features, **actions}.items()}
    return LoadedPolicy(policy, *make_pre_post_processors(config, dataset_stats=stats))


def statistics_of(shape: tuple[int, ...]) -> dict[str, Any]:
    import torch

    size = shape if len(shape) == 1 else (shape[0], 1, 1)
    values = {"mean": 0.3, "std": 0.6, "min": -1.0, "max": 1.5}
    return {name: torch.full(size, value) for name, value in values.items()}


def chunk_row(loaded: Any, folder: Path, repeats: int) -> dict[str, Any]:
    """Differences and times of a policy's chunks."""
    import torch

    from lerobot_act_chunking.policies.exporting.acting import acting_of
    from lerobot_act_chunking.policies.exporting.export import export
    from lerobot_act_chunking.policies.exporting.network import ExportedNetwork

    torch.set_num_threads(1)
    if not folder.exists():
        export(loaded, folder)
    runtime = load_exported(folder, np.random.default_rng(0))
    network = ExportedNetwork(loaded.policy, loaded.preprocessor, acting_of(loaded.policy)).eval()
    rng, differences = np.random.default_rng(0), []
    for _ in range(WINDOWS):
        window, draws = drawn(runtime, rng)
        ours = runtime.predict(window, draws)
        with torch.inference_mode():
            theirs = network(*map(torch.from_numpy, (window | draws).values())).numpy()
        differences.append(float(np.abs(ours - theirs[0]).max() / np.abs(theirs).max()))
    torch_ms, onnx_ms = [], []
    inputs = [torch.from_numpy(each) for each in (window | draws).values()]
    for _ in range(repeats):
        with torch.inference_mode():
            torch_ms.append(cpu_ms(lambda: network(*inputs)))
        onnx_ms.append(cpu_ms(lambda: runtime.predict(window, draws)))
    return {
        "difference": max(differences),
        "windows": WINDOWS,
        "torch_ms": statistics.median(torch_ms),
        "onnx_ms": statistics.median(onnx_ms),
        "graph_mb": (folder / "policy.onnx").stat().st_size / 1e6,
    }


def drawn(runtime: ExportedPolicy, rng: np.random.Generator) -> tuple[dict[str, np.ndarray], ...]:
    """A window and the numbers of a chunk."""
    description = runtime.description
    window = {
        key: (
            rng.integers(256, size=(1, description.n_obs_steps, *spec.shape), dtype=np.uint8)
            if spec.dtype == "uint8"
            else rng.uniform(-1, 1.5, (1, description.n_obs_steps, *spec.shape)).astype(np.float32)
        )
        for key, spec in description.inputs.items()
    }
    return window, Draws(description.draws, rng).take(0)


def cpu_ms(call: Callable[[], object]) -> float:
    """CPU time of one call."""
    begin = time.process_time()
    call()
    return 1e3 * (time.process_time() - begin)


def process_row(name: str, folder: Path, observation: dict[str, Any]) -> dict[str, Any]:
    """What a fresh process takes to import, load and act once."""
    imports, load = START[name]
    program = PROCESS.format(imports=imports, load=load)
    command = [sys.executable, "-c", program, str(folder), json.dumps(observation)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def successes(act: Callable[[dict[str, Any]], np.ndarray], reset: Callable[[], None], n: int) -> list[int]:
    """The seeds whose episodes succeed."""
    from lerobot_act_chunking.envs.making import make_env

    env, succeeded = make_env("transfer_cube", obs_type="state"), []
    for seed in range(FIRST_SEED, FIRST_SEED + n):
        observation, _ = env.reset(seed=seed)
        reset()
        done = success = False
        while not done:
            observation, _, terminated, truncated, info = env.step(act(observation))
            success |= bool(info["is_success"])
            done = terminated or truncated
        if success:
            succeeded.append(seed)
    return succeeded


def gym_names(observation: dict[str, Any]) -> dict[str, Any]:
    """An environment's observation by LeRobot's names, single precision."""
    return {name: observation[gym].astype(np.float32) for name, gym in NAMES.items()}


def largest_difference(trained: Any, runtime: ExportedPolicy) -> float:
    """Of an executed action, as a share of its dimension's range, both seeing what PyTorch's policy does."""
    from lerobot_act_chunking.envs.making import make_env

    env, pairs = make_env("transfer_cube", obs_type="state"), []
    for seed in range(FIRST_SEED, FIRST_SEED + FOLLOWED):
        observation, _ = env.reset(seed=seed)
        trained.reset(), runtime.reset()
        done = False
        while not done:
            pairs.append((trained.act(observation), runtime.act(gym_names(observation))))
            observation, _, terminated, truncated, _ = env.step(pairs[-1][0])
            done = terminated or truncated
    theirs, ours = np.array(pairs).swapaxes(0, 1)
    return float((np.abs(ours - theirs).max(0) / np.ptp(theirs, axis=0)).max())


def measure(folder: Path, parts: list[str], episodes: int, repeats: int) -> dict[str, Any]:
    """These parts of the results."""
    from lerobot_act_chunking.policies.exporting.export import export
    from lerobot_act_chunking.policies.loading import load_policy

    console, exported = Console(), folder / "exported"
    recording = Recording(folder / "everybody", "transfer_cube", operators=PEOPLE)
    training = Training(folder / "act_chunked", TRAINED, 0, recording)
    recording.record(console)
    training.train(console)
    checkpoint = training.checkpoints / "last" / "pretrained_model"
    trained = load_policy(checkpoint)
    if not exported.exists():
        export(trained, exported)
    runtime, found = load_exported(exported, np.random.default_rng(0)), {}
    if "chunks" in parts:
        found["chunks"] = {
            name: chunk_row(planted(*policy), folder / "planted" / name.replace(", ", "_"), repeats)
            for name, policy in POLICIES.items()
        }
    if "processes" in parts:
        inputs = {key: [0.1] * spec.shape[0] for key, spec in runtime.description.inputs.items()}
        found["processes"] = {
            "act_chunking_runtime": process_row("act_chunking_runtime", exported, inputs),
            "lerobot_act_chunking": process_row(
                "lerobot_act_chunking", checkpoint, {NAMES[key]: value for key, value in inputs.items()}
            ),
        }
    if "episodes" in parts:
        found["episodes"] = {
            "n": episodes,
            "lerobot_act_chunking": successes(trained.act, trained.reset, episodes),
            "act_chunking_runtime": successes(
                lambda seen: runtime.act(gym_names(seen)), runtime.reset, episodes
            ),
            "followed": FOLLOWED,
            "difference": largest_difference(trained, runtime),
            "training": training.facts,
        }
    return found


def chunks_table(results: dict[str, Any]) -> str:
    """Differences and times as the page shows them."""
    columns = ["policy as it comes", "largest difference", "PyTorch", "ONNX Runtime", "graph"]
    rows = [
        [
            name,
            f"{row['difference']:.0e}",
            f"{row['torch_ms']:.1f} ms",
            f"{row['onnx_ms']:.1f} ms",
            f"{row['graph_mb']:.1f} MB",
        ]
        for name, row in results["chunks"].items()
    ]
    return markdown(columns, rows)


def processes_table(results: dict[str, Any]) -> str:
    """What the processes take, and how often their policy succeeds."""
    columns = ["process", "import and load", "peak memory", "successes", "95 % interval"]
    episodes, rows = results["episodes"], []
    for name, row in results["processes"].items():
        rate = SuccessRate(len(episodes[name]), episodes["n"])
        took = [f"{row['seconds']:.2f} s", f"{row['memory_mb']:.0f} MB"]
        rows.append([f"`{name}`", *took, f"{rate.successes} of {rate.episodes}", f"{rate.percent} %"])
    differ = {*episodes["lerobot_act_chunking"]} ^ {*episodes["act_chunking_runtime"]}
    return (
        f"{markdown(columns, rows)}\n\n{episodes['n'] - len(differ)} of {episodes['n']} episodes end alike. "
        f"From the same observations, over {episodes['followed']} episodes, an executed action differs by at "
        f"most {episodes['difference']:.0e} of its range."
    )


def markdown(columns: list[str], rows: list[list[str]]) -> str:
    """A table."""
    return "\n".join(f"| {' | '.join(each)} |" for each in (columns, ["---"] * len(columns), *rows))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=ROOT / "outputs/export")
    parser.add_argument("--episodes", type=int, default=EPISODES)
    parser.add_argument("--repeats", type=int, default=30)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    arguments = parser.parse_args()
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    results |= measure(arguments.folder, arguments.parts, arguments.episodes, arguments.repeats)
    write_atomically(RESULTS, (json.dumps(results, indent=1) + "\n").encode())
    show_on(PAGE, CHUNKS, chunks_table(results))
    show_on(PAGE, PROCESSES, processes_table(results))


if __name__ == "__main__":
    main()
