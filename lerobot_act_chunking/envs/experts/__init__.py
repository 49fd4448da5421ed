"""Scripted bimanual experts: the demonstrator for ``act-chunking record``."""

from lerobot_act_chunking.envs.experts.options import ExpertOptions, ExpertPlan
from lerobot_act_chunking.envs.experts.planner import plan

__all__ = ["ExpertOptions", "ExpertPlan", "plan"]
