"""Scripted experts of the SO-101: the demonstrator for ``act-chunking record`` and for the teleoperator."""

from lerobot_act_chunking.envs.so_arm.experts.planner import RANGES, plan

__all__ = ["RANGES", "plan"]
