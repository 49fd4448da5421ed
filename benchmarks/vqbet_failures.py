"""Where the recipe of docs/policies/vqbet.md fails: how far from the demonstrations those episodes begin.

    python benchmarks/vqbet_failures.py        # after benchmarks/vqbet_success.py --studies recipe

reads benchmarks/results/vqbet_recipe.json and the recording of `insertion`.
"""

import argparse
import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pyarrow.parquet as pq
from execution_study import FIRST_SEED

import lerobot_act_chunking  # noqa: F401  (registers aloha_sim)
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig

RECORDINGS = Path("outputs/benchmarks/quickstart")
PLACES = [0, 1, 7, 8]
"""Of the environment state: x and y of both objects [m]."""


def demonstrated(recordings: Path) -> np.ndarray:
    """Where the objects lie when demonstrations begin, (N, 4)."""
    table = pq.read_table(
        recordings / "insertion/dataset/data", columns=["frame_index", "observation.environment_state"]
    )
    states = np.stack(table["observation.environment_state"].to_numpy())
    return states[np.array(table["frame_index"]) == 0][:, PLACES]


def evaluated(episodes: int) -> np.ndarray:
    """Where they lie when the evaluated episodes begin, (N, 4)."""
    config = AlohaSimEnvConfig(task="insertion", obs_type="state")
    env = gym.make(config.gym_id, disable_env_checker=True, **config.gym_kwargs)
    seeds = range(FIRST_SEED, FIRST_SEED + episodes)
    return np.stack([env.reset(seed=seed)[0]["environment_state"][PLACES] for seed in seeds])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--results", type=Path, default=Path("benchmarks/results"))
    parser.add_argument("--recordings", type=Path, default=RECORDINGS)
    args = parser.parse_args()
    results = json.loads((args.results / "vqbet_recipe.json").read_text())
    cells = [cell for cell in results if cell["run"]["task"] == "insertion"]
    episodes = cells[0]["episodes"]
    failed = np.zeros(episodes, dtype=int)
    for cell in cells:
        failed[np.array(cell["failed_seeds"], dtype=int) - FIRST_SEED] += 1
    starts, demos = evaluated(episodes), demonstrated(args.recordings)
    beyond = ((starts < demos.min(0)) | (starts > demos.max(0))).any(1)
    for name, group in (("beyond the demonstrations' range", beyond), ("within it", ~beyond)):
        print(f"{name}: {failed[group].sum()} failures in {len(cells) * group.sum()} episodes")


if __name__ == "__main__":
    main()
