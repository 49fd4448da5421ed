"""The moving picture of the README: the simulated ALOHA, moved by its scripted expert.

    MUJOCO_GL=egl python benchmarks/robot_gif.py

writes docs/images/transfer_cube.gif.
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.aloha.experts import plan
from lerobot_act_chunking.envs.demonstration import ExpertOptions


def frames(env: AlohaSimEnv, seed: int, every: int) -> list[np.ndarray]:
    """Images (height, width, 3) of the expert's episode, one of so many control steps."""
    observation, _ = env.reset(seed=seed)
    script = plan(env.task, env.world.environment_state(), ExpertOptions(), np.random.default_rng(0))
    images = []
    for step, command in enumerate(script.commands):
        if step % every == 0:
            images.append(observation["pixels"]["angle"])
        observation, *_ = env.step(command)
    return [*images, *[observation["pixels"]["angle"]] * 8]  # the end stays for a while


def write_gif(images: list[np.ndarray], path: Path, colors: int, seconds: float) -> None:
    """All frames with the palette of one in the middle, so that nothing flickers."""
    palette = Image.fromarray(images[len(images) // 2]).quantize(colors)
    pictures = [
        Image.fromarray(image).quantize(palette=palette, dither=Image.Dither.NONE) for image in images
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=int(1000 * seconds), loop=0, optimize=True
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="transfer_cube")
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--every", type=int, default=4, help="control steps from one frame to the next")
    parser.add_argument("--colors", type=int, default=64)
    parser.add_argument("--out", type=Path, default=Path("docs/images/transfer_cube.gif"))
    args = parser.parse_args()

    size = {"observation_height": 240, "observation_width": 320}
    env = AlohaSimEnv(task=args.task, obs_type="pixels_state", cameras=["angle"], success="hold", **size)
    images = frames(env, args.seed, args.every)
    env.close()
    write_gif(images, args.out, args.colors, args.every / env.metadata["render_fps"])
    print(f"{args.out}: {len(images)} frames, {args.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
