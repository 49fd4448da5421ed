"""Encoders that read an instruction beside the robot's tokens, and their start from a language model."""
