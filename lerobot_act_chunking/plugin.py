"""Everything LeRobot learns when it discovers this package: policy types, environment types, a
simulated robot and its teleoperator, fast chunks, the local hub if there is one, and model cards.

LeRobot imports the installed module ``lerobot_policy_act_chunking`` (a copy of ``_lerobot_plugin.py``), which
imports this one. Policies and environments are registered by their configurations and what these need; the
networks, the simulations and the instruments are imported when they are used, LeRobot's way: by module name.
"""

import lerobot_act_chunking.envs.configuration_envs
import lerobot_act_chunking.envs.configuration_robotics
import lerobot_act_chunking.envs.configuration_so_arm
import lerobot_act_chunking.envs.configuration_three_gates
import lerobot_act_chunking.policies.act_chunked.configuration_act_chunked
import lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked
import lerobot_act_chunking.policies.language.tokens
import lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble
import lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked
import lerobot_act_chunking.robots.config_so_arm_sim
import lerobot_act_chunking.robots.config_so_arm_teleop  # noqa: F401
from lerobot_act_chunking import hub
from lerobot_act_chunking.data import fast_chunks
from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg
from lerobot_act_chunking.policies import late_chunks, model_card, rollout_watch

fast_chunks.install()
hub.install()
model_card.install()
late_chunks.install()
rollout_watch.install()
quiet_missing_ffmpeg()
