"""Everything LeRobot learns when it discovers this package: policy types, environment types, fast chunks.

LeRobot imports the installed module ``lerobot_policy_act_chunking`` (a copy of ``_lerobot_plugin.py``), which imports
this one. Only configurations are imported here; LeRobot finds policies and processors by module name.
"""

from lerobot_act_chunking.envs import configuration_envs as _environments
from lerobot_act_chunking.policies.act_chunked import configuration_act_chunked as _act_chunked

__all__: list[str] = []
_ = (_environments, _act_chunked)
