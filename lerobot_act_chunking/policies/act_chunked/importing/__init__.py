"""From checkpoints of LeRobot's ``act``, of any version, to checkpoints of `act_chunked`."""
