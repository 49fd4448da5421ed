"""The SO-101 in MuJoCo, with the observations and actions of LeRobot's ``so101_follower``."""
