"""ALOHA demonstrations: the scripted bimanual experts as a source of episodes."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from lerobot_act_chunking.envs.aloha.env import AlohaSimEnv
from lerobot_act_chunking.envs.aloha.experts import RANGES, plan
from lerobot_act_chunking.envs.aloha.instructions import COLOURS
from lerobot_act_chunking.envs.aloha.options import AlohaSimOptions
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES, get_task
from lerobot_act_chunking.recording.simulated import SimulatedSource, Step, World, noise_stream

_OBJECTS = {
    "transfer_cube": ("cube",),
    "insertion": ("peg", "socket"),
    "transfer_modes": ("cube",),
    "language_transfer": tuple(f"{colour}_cube" for colour in COLOURS),
}
_POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")


@dataclass(frozen=True)
class AlohaSource(SimulatedSource):
    """Episodes of a bimanual expert; seed s begins like seed s of gym-aloha."""

    environment: AlohaSimOptions

    env_type = "aloha_sim"
    distributions = ("gym-aloha",)

    ranges = RANGES

    @property
    def world(self) -> World:
        """Joints, and the poses of the task's objects."""
        vectors: dict[str, tuple[str, ...]] = {}
        if self.environment.obs_type != "pixels":
            vectors["agent_pos"] = JOINT_NAMES
        if self.environment.agent_vel:
            vectors["agent_vel"] = JOINT_NAMES
        if self.environment.obs_type == "state":
            objects = _OBJECTS[self.environment.task]
            vectors["environment_state"] = tuple(f"{thing}_{entry}" for thing in objects for entry in _POSE)
        task, fps = get_task(self.environment.task), AlohaSimEnv.metadata["render_fps"]
        return World(fps, task.instruction, "aloha", JOINT_NAMES, vectors, task.modes)

    @property
    def settings(self) -> dict[str, Any]:
        """As of every source; without what only a task with several instructions has."""
        kept = super().settings
        if not get_task(self.environment.task).cubes:
            del kept["instructions"]
        return kept

    def make_env(self) -> AlohaSimEnv:
        """The simulation."""
        return AlohaSimEnv(render_mode=None, **asdict(self.environment))

    def steps(self, env: AlohaSimEnv, seed: int) -> Iterator[Step]:
        """Play a plan to its end; a success does not cut it short."""
        observation, _ = env.reset(seed=seed)
        pose, options, rng = env.world.environment_state(), self.options_of(seed), noise_stream(seed)
        script = plan(env.task, pose, options, rng, mode=self.mode_of(seed), goal=env.goal)
        for action, command in zip(script.actions, script.commands, strict=True):
            seen = observation
            observation, _, _, _, info = env.step(command)
            yield Step(seen, action, info, env.task_description)
