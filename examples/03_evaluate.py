"""Evaluate a checkpoint on unseen cube positions, with the interval that the number of episodes allows."""

import argparse

import torch
from lerobot.envs.factory import make_env, make_env_pre_post_processors
from lerobot.scripts.lerobot_eval import eval_policy_all

from lerobot_act_chunking.diagnostics.core.statistics import SuccessRate
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.policies.loading import load_policy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", default="outputs/examples/train/checkpoints/last/pretrained_model")
    parser.add_argument("--episodes", type=int, default=200)
    args = parser.parse_args()

    policy, preprocessor, postprocessor = load_policy(args.policy)
    env_config = AlohaSimEnvConfig(task="transfer_cube", obs_type="state", success="hold")
    envs = make_env(env_config, n_envs=min(50, args.episodes))
    env_preprocessor, env_postprocessor = make_env_pre_post_processors(env_config, policy.config)
    with torch.no_grad():
        info = eval_policy_all(
            envs,
            policy,
            env_preprocessor,
            env_postprocessor,
            preprocessor,
            postprocessor,
            n_episodes=args.episodes,
            start_seed=1000,
        )
    for env in envs["aloha_sim"].values():
        env.close()

    outcomes = info["per_task"][0]["metrics"]["successes"]
    print(f"lifted and held by the left arm alone: {SuccessRate(sum(outcomes), len(outcomes))}")


if __name__ == "__main__":
    main()
