"""Use a trained policy in a control loop of your own: observation in, action out, one step at a time."""

import argparse

import lerobot_act_chunking as ac


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", default="outputs/examples/train/checkpoints/last/pretrained_model")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=400)
    args = parser.parse_args()

    policy = ac.load_policy(args.policy)
    env = ac.make_env("transfer_cube", obs_type="state")
    observation, info = env.reset(seed=args.seed)
    policy.reset()  # forgets the chunk of an earlier episode
    steps, done = 0, False
    while steps < args.steps and not done:
        observation, _reward, terminated, truncated, info = env.step(policy.act(observation))
        steps, done = steps + 1, terminated or truncated
    env.close()
    print(f"{'success' if info['is_success'] else 'no success'} after {steps} steps")


if __name__ == "__main__":
    main()
