"""LeRobot policies: each folder holds the triple configuration_, modeling_, processor_ LeRobot looks for."""
