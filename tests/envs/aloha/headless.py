"""Run a program as on a machine without a display on which nobody chose an OpenGL platform."""

import os
import subprocess
import sys

CHOICES = ("MUJOCO_GL", "PYOPENGL_PLATFORM", "DISPLAY")


def run_headless(program: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """The finished Python ``program``; ``variables`` are added to its environment."""
    environment = {name: value for name, value in os.environ.items() if name not in CHOICES}
    command = [sys.executable, "-c", program]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment | variables)
