"""Demonstrations of the three gates: their scripted expert as a source of episodes."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass

from lerobot_act_chunking.envs.three_gates.env import INSTRUCTION, ThreeGatesEnv
from lerobot_act_chunking.envs.three_gates.expert import RANGES, plan
from lerobot_act_chunking.envs.three_gates.options import ThreeGatesOptions
from lerobot_act_chunking.envs.three_gates.world import ACTION_NAMES, FPS, GATES
from lerobot_act_chunking.recording.simulated import SimulatedSource, Step, World, noise_stream


@dataclass(frozen=True)
class ThreeGatesSource(SimulatedSource):
    """Episodes of the expert that leaves the ring."""

    environment: ThreeGatesOptions

    env_type = "three_gates"
    distributions = ()
    ranges = RANGES

    @property
    def world(self) -> World:
        """The mass, and the gates as it sees them."""
        vectors: dict[str, tuple[str, ...]] = {}
        if self.environment.obs_type != "pixels":
            vectors["agent_pos"] = ("x", "y")
        if self.environment.agent_vel:
            vectors["agent_vel"] = ("x", "y")
        if self.environment.obs_type == "state":
            vectors["environment_state"] = tuple(
                f"gate_{gate}_{axis}" for gate in range(len(GATES)) for axis in "xy"
            )
        return World(FPS, INSTRUCTION, "point_mass", ACTION_NAMES, vectors, modes=len(GATES))

    def make_env(self) -> ThreeGatesEnv:
        """The simulation."""
        return ThreeGatesEnv(render_mode=None, **asdict(self.environment))

    def steps(self, env: ThreeGatesEnv, seed: int) -> Iterator[Step]:
        """Play a plan to its end; a success does not cut it short."""
        observation, _ = env.reset(seed=seed)
        options, rng = self.options_of(seed), noise_stream(seed)
        plans = plan(env.world.qpos(), options, rng, mode=self.mode_of(seed))
        for action, command in zip(*plans, strict=True):
            seen = observation
            observation, _, _, _, info = env.step(command)
            yield Step(seen, action, info)
