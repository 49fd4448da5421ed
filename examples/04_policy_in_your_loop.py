"""Use a trained policy in a control loop of your own: observation in, action out, one step at a time."""

import argparse

import gymnasium as gym
import torch

import lerobot_act_chunking  # noqa: F401  (registers the Gymnasium ids)
from lerobot_act_chunking.policies.loading import load_policy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", default="outputs/examples/train/checkpoints/last/pretrained_model")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=400)
    args = parser.parse_args()

    policy, preprocessor, postprocessor = load_policy(args.policy)
    env = gym.make("aloha_sim/TransferCube-v0", obs_type="state")
    observation, info = env.reset(seed=args.seed)
    policy.reset()  # forgets the chunk of an earlier episode
    steps, done = 0, False
    while steps < args.steps and not done:
        batch = preprocessor(
            {
                "observation.state": torch.from_numpy(observation["agent_pos"]).float(),
                "observation.environment_state": torch.from_numpy(observation["environment_state"]).float(),
            }
        )
        with torch.inference_mode():
            action = postprocessor(policy.select_action(batch))[0]
        observation, _reward, terminated, truncated, info = env.step(action.numpy())
        steps, done = steps + 1, terminated or truncated
    env.close()
    print(f"{'success' if info['is_success'] else 'no success'} after {steps} steps")


if __name__ == "__main__":
    main()
