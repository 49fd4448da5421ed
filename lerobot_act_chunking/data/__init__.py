"""Chunk timing, the door from LeRobot's batch dictionaries, padding masks, and fast chunk loading."""
