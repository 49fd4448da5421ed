"""Scripted bimanual experts: the demonstrator for ``act-chunking record``."""

from lerobot_act_chunking.envs.aloha.experts.planner import RANGES, plan
from lerobot_act_chunking.envs.demonstration import ExpertOptions
from lerobot_act_chunking.envs.strokes import ExpertPlan

__all__ = ["RANGES", "ExpertOptions", "ExpertPlan", "plan"]
