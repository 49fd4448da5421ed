"""Record scripted demonstrations into a LeRobotDataset, then read back what was recorded."""

import argparse
from pathlib import Path

from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.recording import RecordSpec, record


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path, default=Path("outputs/examples/dataset"))
    parser.add_argument("--episodes", type=int, default=50)
    args = parser.parse_args()

    result = record(RecordSpec(repo_id="local/transfer_cube", root=args.root, episodes=args.episodes))
    print(f"recorded {result.episodes} episodes, {result.frames} frames in {result.root}")

    dataset = LeRobotDataset("local/transfer_cube", root=args.root)
    first = dataset[0]
    for key in ("observation.state", "observation.environment_state", "action"):
        print(f"{key}: {tuple(first[key].shape)} {first[key].dtype}")


if __name__ == "__main__":
    main()
