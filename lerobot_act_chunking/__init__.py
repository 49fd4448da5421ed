"""Action-chunking policies and ALOHA simulation for LeRobot.

Importing this package registers the Gymnasium environments and stays cheap (no torch, no LeRobot). LeRobot's
own commands import ``lerobot_act_chunking.plugin`` through the discovery shim, which registers the rest.
"""

from lerobot_act_chunking.envs.registration import register_gymnasium_ids

register_gymnasium_ids()
