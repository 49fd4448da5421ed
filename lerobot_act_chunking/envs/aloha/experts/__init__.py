"""Scripted bimanual experts: the demonstrator for ``act-chunking record``."""

from lerobot_act_chunking.envs.aloha.experts.planner import RANGES, ExpertPlan, plan
from lerobot_act_chunking.envs.demonstration import ExpertOptions

__all__ = ["RANGES", "ExpertOptions", "ExpertPlan", "plan"]
