"""Execute one checkpoint's chunks in several ways on the same episodes: any policy type, no retraining."""

import argparse

from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.diagnostics.smoothness.measuring import measure
from lerobot_act_chunking.diagnostics.smoothness.sources import action_std
from lerobot_act_chunking.policies.temporal_ensemble.wrapping import load_wrapped

WAYS = {
    "each chunk to its end": {"execution": "open_loop"},
    "newest chunk, every 25 steps": {"execution": "receding", "replan_interval": 25},
    "blended in over 10 steps": {"execution": "crossfade", "replan_interval": 25, "crossfade_steps": 10},
    "temporal ensemble": {"execution": "ensemble", "replan_interval": 25, "temporal_ensemble_coeff": 0.01},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", default="outputs/examples/train/checkpoints/last/pretrained_model")
    parser.add_argument("--task", default="transfer_cube")
    parser.add_argument("--episodes", type=int, default=20)
    args = parser.parse_args()

    for name, settings in WAYS.items():
        loaded = load_wrapped(args.policy, **settings)
        env_config = environment_of(loaded.policy.config, task_environment(args.task, "touch"))
        rollouts = roll_out(loaded, env_config, seeds=range(1000, 1000 + args.episodes))
        report = measure(rollouts, action_std=action_std(loaded))
        rate = SuccessRate(sum(rollout.success for rollout in rollouts), len(rollouts))
        print(f"{name}: {rate}")
        print(f"  boundary discontinuity {report.commanded.arms.boundary_ratio}")
        print(f"  network calls per episode {report.network_calls_per_episode}")


if __name__ == "__main__":
    main()
