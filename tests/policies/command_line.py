"""What a command of LeRobot parses, as far as policies go."""

from dataclasses import dataclass

from lerobot.configs import PreTrainedConfig

import lerobot_act_chunking.plugin  # noqa: F401  (registers the policies)


@dataclass
class Command:
    policy: PreTrainedConfig
