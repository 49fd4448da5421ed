"""Neural blocks: observation tokens, transformer, style encoder, weight average. No LeRobot, no configs."""
