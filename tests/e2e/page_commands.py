"""The commands of a page, run one after the other as a reader does, with smaller sizes."""

import os
import re
import socket
import subprocess
import sys
import time
from pathlib import Path
from subprocess import PIPE, STDOUT

ROOT = Path(__file__).parents[2]
CAMERAS = "{front: {width: 64, height: 48}, wrist: {width: 64, height: 48}}"
SMALLER = {
    "(--robot.type=so_arm_sim)": f"(--robot.type=so_arm_sim --robot.cameras='{CAMERAS}')",
    "--teleop_time_s=60": "--teleop_time_s=2",
    "--dataset.num_episodes=50": "--dataset.num_episodes=3",
    "--dataset.num_episodes=20": "--dataset.num_episodes=2",
    "--dataset.episode_time_s=9": "--dataset.episode_time_s=7",
    "--dataset.episode_time_s=20": "--dataset.episode_time_s=3",
    "--dataset.reset_time_s=5": "--dataset.reset_time_s=2",
    "seq -s, 0 44": "seq -s, 0 1",
    "[240, 320]": "[36, 48]",
    "[360, 480]": "[48, 64]",
    "[224, 304]": "[32, 40]",
    "--batch_size=8": "--batch_size=2",
    "--num_workers=2": "--num_workers=0",
    "--steps=20000": "--steps=2",
    "--steps=40000": "--steps=2",
    "--save_freq=20000": "--save_freq=2",
    "--duration=60": "--duration=3",
}
"""Sizes of a page, and what a test has time for."""
CLIENT = "python -m lerobot.async_inference.robot_client"
SETTING = re.compile(r"[A-Z]+=")


def commands(page: Path) -> list[str]:
    """Every command of a page, in order, each on one line; settings of variables among them."""
    found = []
    for block in re.findall(r"^```bash\n(.*?)^```", page.read_text(), flags=re.M | re.S):
        joined = re.sub(r"\\\n\s*", "", block)
        joined = re.sub(r"^([A-Z]+=\([^\n]*)\n\s+", r"\1 ", joined, flags=re.M)
        found += [line for line in joined.splitlines() if line]
    return found


def smaller(command: str) -> str:
    """The same command with the sizes of a test."""
    for size, less in SMALLER.items():
        command = command.replace(size, less)
    return command


class Terminal:
    """Runs commands in a folder; what variables are set to holds for those that follow."""

    def __init__(self, folder: Path):
        self.folder, self._settings, self._server = folder, [], None
        scripts = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        self._env = {**os.environ, "PATH": scripts, "HF_HUB_OFFLINE": "1"}
        self._env["HF_LEROBOT_HOME"] = str(folder / "home")

    def run(self, command: str) -> str:
        """Run one command to its end, and give what it says; a server stays, a client is stopped."""
        if SETTING.match(command):
            self._settings.append(command)
            return ""
        if command.startswith("act-chunking serve"):
            self._server = subprocess.Popen(self._bash(f"exec {command}"), **self._where())
            until = time.monotonic() + 120
            while not _listens() and time.monotonic() < until:
                time.sleep(0.1)
            return ""
        if command.startswith(CLIENT):
            command = f"env --default-signal=INT timeout --signal=INT 60 {command}"
        done = subprocess.run(
            self._bash(command), stdout=PIPE, stderr=STDOUT, text=True, check=False, **self._where()
        )
        expected = (124, 130) if "timeout --signal" in command else (0, 10, 11) if _judges(command) else (0,)
        assert done.returncode in expected, f"{command}\n{done.stdout[-4000:]}"
        return done.stdout

    def close(self) -> None:
        """End the server, if one was started."""
        if self._server is not None:
            self._server.kill()
            self._server.wait()

    def _bash(self, command: str) -> list[str]:
        return ["bash", "-c", "\n".join([*self._settings, command])]

    def _where(self) -> dict:
        return {"cwd": self.folder, "env": self._env}


def _listens(port: int = 8080) -> bool:
    """Whether anybody answers at a port of this machine."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _judges(command: str) -> bool:
    """Whether it ends with a verdict, which of a policy that has learned nothing may be a bad one."""
    return command.split()[1] in ("data", "replay", "check")
