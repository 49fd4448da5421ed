"""What following instructions costs in a control step: the same policy with and without, in turns.

    OMP_NUM_THREADS=1 python benchmarks/language_step.py

Policies as they come, for the observations of `language_transfer`, with weights that have learned nothing.
A turn is 200 control steps of each, the preprocessor, the policy and the postprocessor together, in CPU time;
the ratio is the median over turns. The instruction stays the same, so the sentence encoder runs once, in the
first turn, which does not count. Writes benchmarks/results/language_step.json.
"""

import argparse
import json
import statistics
import time
from pathlib import Path

import torch
from lerobot.configs import FeatureType, PreTrainedConfig
from lerobot.envs.utils import env_to_policy_features
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

import lerobot_act_chunking.plugin  # noqa: F401  (registers the policies)
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.policies.loading import LoadedPolicy

RESULTS = Path(__file__).parents[1] / "benchmarks/results/language_step.json"
TYPES, STEPS = ("act_chunked", "diffusion_chunked", "vqbet_chunked"), 200
TASK = "Hand the red cube to the left arm."


def make(policy_type: str, encoder: str | None) -> LoadedPolicy:
    features = env_to_policy_features(AlohaSimEnvConfig(task="language_transfer"))
    actions = {key: each for key, each in features.items() if each.type is FeatureType.ACTION}
    inputs = {key: each for key, each in features.items() if key not in actions}
    config = PreTrainedConfig.get_choice_class(policy_type)(
        input_features=inputs,
        output_features=actions,
        device="cpu",
        push_to_hub=False,
        language_encoder=encoder,
    )
    values = {"mean": 0.0, "std": 1.0, "min": -1.0, "max": 1.0}
    stats = {
        key: {name: torch.full(each.shape, value) for name, value in values.items()}
        for key, each in features.items()
    }
    torch.manual_seed(0)
    policy = get_policy_class(policy_type)(config)
    if policy_type == "vqbet_chunked":
        policy.tokenizer_phase.n_learned.fill_(policy.tokenizer_phase.n_steps)
    return LoadedPolicy(policy.eval(), *make_pre_post_processors(config, dataset_stats=stats))


def turn(loaded: LoadedPolicy) -> float:
    """Milliseconds of CPU for one control step."""
    inputs = loaded.policy.config.input_features
    loaded.reset()
    started = time.process_time()
    for _ in range(STEPS):
        seen = {key: torch.zeros(1, *each.shape) for key, each in inputs.items()}
        with torch.inference_mode():
            loaded.postprocessor(loaded.policy.select_action(loaded.preprocessor({**seen, "task": [TASK]})))
    return 1000 * (time.process_time() - started) / STEPS


def paired(without: LoadedPolicy, told: LoadedPolicy, told_first: bool) -> tuple[float, float]:
    """Both in turn, so that neither has always the warmer machine."""
    if told_first:
        last = turn(told)
        return turn(without), last
    return turn(without), turn(told)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--turns", type=int, default=30)
    parser.add_argument("--out", type=Path, default=RESULTS)
    args = parser.parse_args()
    rows = []
    for policy_type in TYPES:
        without, told = make(policy_type, None), make(policy_type, "minilm")
        times = [paired(without, told, number % 2 == 1) for number in range(args.turns + 1)][1:]
        rows.append(
            {
                "policy": policy_type,
                "without_ms": statistics.median(each[0] for each in times),
                "with_ms": statistics.median(each[1] for each in times),
                "ratio": statistics.median(b / a for a, b in times),
                "turns": args.turns,
                "threads": torch.get_num_threads(),
            }
        )
        print(rows[-1])
    args.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
