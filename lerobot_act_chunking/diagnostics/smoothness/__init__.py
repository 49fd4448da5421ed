"""Smoothness of what a policy commands and of what the robot makes of it: numbers, JSON and pictures."""
