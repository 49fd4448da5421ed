"""gymnasium-robotics' worlds in LeRobot's shape: one table of tasks, one environment over the originals."""
