"""Scripted experts of the Fetch tasks: feedback controllers that demonstrate for ``act-chunking record``."""

from lerobot_act_chunking.envs.robotics.experts.expert import EXPERTS, RANGES, Expert

__all__ = ["EXPERTS", "RANGES", "Expert"]
