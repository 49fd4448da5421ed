"""How far apart predictions may lie in time: what demonstrations lose when they are interpolated."""
