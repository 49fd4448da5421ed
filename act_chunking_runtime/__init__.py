"""Policies from `act-chunking export` on a robot: NumPy and ONNX Runtime, no PyTorch and no LeRobot.

>>> from act_chunking_runtime.policy import load
"""
