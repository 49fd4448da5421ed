"""Policies that act over a network: LeRobot's policy server, with every policy type that is installed."""
