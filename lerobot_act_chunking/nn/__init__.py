"""Neural blocks: attention, transformer, positions, vision, observations, style. No LeRobot, no config objects."""
