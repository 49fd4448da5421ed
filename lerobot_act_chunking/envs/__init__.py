"""Simulated environments and their scripted experts."""
