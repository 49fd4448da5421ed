"""LeRobot policies; each folder holds the triple configuration_, modeling_, processor_ that LeRobot looks for."""
