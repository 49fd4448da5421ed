"""Demonstrations in gymnasium-robotics' worlds: the scripted Fetch experts as a source of episodes."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass

from lerobot_act_chunking.envs.robotics.env import RoboticsEnv
from lerobot_act_chunking.envs.robotics.experts import EXPERTS, RANGES, Expert
from lerobot_act_chunking.envs.robotics.options import RoboticsOptions
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.recording.simulated import SimulatedSource, Step, World, noise_stream


@dataclass(frozen=True)
class RoboticsSource(SimulatedSource):
    """Episodes of a Fetch expert; seed s begins like seed s of the original.

    With ``success="final"`` an episode goes on to its time limit, holding what it reached; with ``any`` it
    ends at the first success.
    """

    environment: RoboticsOptions

    env_type = "gymnasium_robotics"
    distributions = ("gymnasium-robotics",)
    ranges = RANGES

    def __post_init__(self) -> None:
        task = self.environment.task
        if task not in EXPERTS:
            raise ConfigurationError(
                f"{task} has no scripted expert; choose one of: {', '.join(EXPERTS)}, or bring your own "
                "demonstrator and record it with record_source (docs/guides/own-environment.md)"
            )
        super().__post_init__()

    @property
    def world(self) -> World:
        """The task's row in the table."""
        task = self.environment.layout
        vectors: dict[str, tuple[str, ...]] = {}
        if self.environment.obs_type != "pixels":
            vectors["agent_pos"] = task.state_names
        if self.environment.obs_type == "state":
            vectors["environment_state"] = task.environment_names
        return World(task.fps, task.instruction, "fetch", task.actions, vectors)

    def make_env(self) -> RoboticsEnv:
        """The simulation."""
        return RoboticsEnv(render_mode=None, **asdict(self.environment))

    def steps(self, env: RoboticsEnv, seed: int) -> Iterator[Step]:
        """Answer what is seen until the episode ends."""
        observation, _ = env.reset(seed=seed)
        expert = Expert(env.task, self.options_of(seed), noise_stream(seed), env.max_episode_steps)
        over = False
        while not over:
            action, command = expert.act(env.named_state)
            seen = observation
            observation, _, terminated, truncated, info = env.step(command)
            over = terminated or truncated
            yield Step(seen, action, info)
