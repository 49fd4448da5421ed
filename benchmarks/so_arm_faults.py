"""Everything that can go wrong with the simulated SO-101, in every way of acting: what the arm is told then.

    MUJOCO_GL=egl python benchmarks/so_arm_faults.py CHECKPOINT [--seconds 8] [--modes rtc] [--faults none]
    python benchmarks/so_arm_faults.py --table   # docs/guides/practice-arm.md

Each cell is LeRobot's own command in a process of its own. The results are in
benchmarks/results/so_arm_faults.json. A jump is the largest change of a target in one step, in multiples of
the largest demonstrated change of that joint, or of the change in the step before or after, if that is more:
a policy that plans to move fast does not leap.
"""

import argparse
import json
import multiprocessing
import os
import re
import runpy
import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from lerobot.configs import PreTrainedConfig
from lerobot.utils.import_utils import register_third_party_plugins

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "so_arm_faults.json"
PAGE = ROOT / "docs" / "guides" / "practice-arm.md"
BEGIN, END = "<!-- faults: python benchmarks/so_arm_faults.py --table -->\n\n", "\n<!-- end -->"
FPS = 30
PATIENCE = 120.0  # [s] for a command to begin
AFTER = {"after_s": "3"}
FAULTS: dict[str, dict[str, str]] = {
    "none": {},
    "dropped frames": {"dropped_frames": "0.5"},
    "frozen camera": {"frozen_camera": "wrist", **AFTER},
    "late observation": {"late_observation_s": "0.2"},
    "loop jitter": {"loop_jitter_s": "0.03"},
    "blocked joint": {"blocked_joint": "elbow_flex", **AFTER},
    "unplugged camera": {"unplugged_camera": "wrist", **AFTER},
}
MODES: dict[str, list[str]] = {
    "sync": [],
    "background": ["--policy.background=true"],
    "rtc": ["--inference.type=rtc", "--inference.rtc.execution_horizon=30"],
    "served": [],
}
KILLED = CLIENT_KILLED, SERVER_KILLED = "client killed, started again", "server killed, started again"
FORK = multiprocessing.get_context("fork")
TOLD = re.compile(r"^(?:WARNING|ERROR|\S*Error|.*(?:WARNING|ERROR)\b).*$", re.M)
STAMP = re.compile(r"^.*?(?:WARNING|ERROR)\S*\s*(?:[\d:\- ]*)(?:\S+\.py:\d+ )?|\x1b\[\d*m")


def note_actions(notes: Path, log: Path, module: str, arguments: list[str]) -> None:
    """Run a command, and write down what it says, and what it tells the arm and when.

    In a process of its own, forked from this one: Python and PyTorch are imported once.
    """
    from lerobot_act_chunking.robots.so_arm_sim import SoArmSim

    with log.open("ab", buffering=0) as out:
        for stream in (1, 2):
            os.dup2(out.fileno(), stream)
    os.chdir(notes.parent)  # LeRobot's client writes logs where it runs
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background lets it be ignored
    send = SoArmSim.send_action
    with notes.open("a") as file:

        def noting(robot: Any, action: Any) -> Any:
            sent = send(robot, action)
            file.write(json.dumps([time.time(), *sent.values()]) + "\n")
            file.flush()
            return sent

        SoArmSim.send_action = noting
        sys.argv = [module, *arguments]
        runpy.run_module(module, run_name="__main__")


def started(notes: Path, log: Path, module: str, *arguments: str) -> Any:
    """`note_actions` of a command, which has begun."""
    process = FORK.Process(target=note_actions, args=(notes, log, module, list(arguments)))
    process.start()
    return process


def ended(process: Any, patience: float = PATIENCE) -> int | None:
    """The exit status of a process, once it is there; None if it had to be killed."""
    process.join(patience)
    if process.exitcode is None:
        process.kill()
        process.join()
        return None
    return process.exitcode


@contextmanager
def serving(checkpoint: str, port: int, notes: Path, log: Path) -> Iterator[Any]:
    """``act-chunking serve``, listening."""
    arguments = ["serve", checkpoint, "--port", str(port)]
    server = started(notes, log, "lerobot_act_chunking.cli.main", *arguments)
    try:
        wait_until(lambda: listens(port) or server.exitcode is not None)
        yield server
    finally:
        server.kill()
        server.join()


def listens(port: int) -> bool:
    """Whether anybody answers at a port of this machine."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def free_port() -> int:
    """A port of this machine that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_until(condition: Any, patience: float = PATIENCE) -> None:
    """Wait for what another process does."""
    until = time.monotonic() + patience
    while not condition() and time.monotonic() < until:
        time.sleep(0.05)


def robot_options(checkpoint: str, fault: dict[str, str]) -> list[str]:
    """The arm with the cameras that the policy knows."""
    register_third_party_plugins()
    config = PreTrainedConfig.from_pretrained(checkpoint)
    sizes = {key.rpartition(".")[2]: each.shape for key, each in config.image_features.items()}
    cameras = ", ".join(f"{name}: {{width: {shape[2]}, height: {shape[1]}}}" for name, shape in sizes.items())
    faults = [f"--robot.faults.{name}={value}" for name, value in fault.items()]
    return ["--robot.type=so_arm_sim", f"--robot.cameras={{{cameras}}}", "--robot.seed=1000", *faults]


def run(checkpoint: str, mode: str, fault: str, seconds: float, folder: Path) -> dict[str, Any]:
    """One cell: what the arm was told, how the command ended, and what it said."""
    notes, log = folder / "notes", folder / "log"
    robot = robot_options(checkpoint, FAULTS.get(fault, {}))
    if mode == "served":
        status = _served(checkpoint, fault, seconds, robot, notes, log)
    else:
        policy = [f"--policy.path={checkpoint}", "--policy.device=cpu", "--device=cpu", *MODES[mode]]
        rest = [f"--duration={seconds}", f"--fps={FPS}", "--return_to_initial_position=false"]
        acting = started(notes, log, "lerobot.scripts.lerobot_rollout", *policy, *robot, *rest)
        status = ended(acting, PATIENCE + 2 * seconds)
    said, until = log.read_text(errors="replace"), time.time() if mode == "served" else None
    return {
        "mode": mode,
        "fault": fault,
        "exit": status,
        **moves(checkpoint, notes, until),
        "said": told(said),
    }


def _served(
    checkpoint: str, fault: str, seconds: float, robot: list[str], notes: Path, log: Path
) -> int | None:
    """LeRobot's client for so long, and its exit status; it is stopped as by Ctrl-C."""
    port, kind = free_port(), PreTrainedConfig.from_pretrained(checkpoint).type
    asked = [f"--server_address=127.0.0.1:{port}", f"--policy_type={kind}", f"--fps={FPS}", *robot]
    asked += [f"--pretrained_name_or_path={checkpoint}", "--actions_per_chunk=40", "--policy_device=cpu"]
    asked += ["--aggregate_fn_name=latest_only"]

    def client() -> Any:
        process = started(notes, log, "lerobot.async_inference.robot_client", *asked)
        wait_until(lambda: lines(notes) > 0 or process.exitcode is not None)
        time.sleep(seconds / 2)
        return process

    with serving(checkpoint, port, notes, log) as server:
        acting = client()
        if fault == CLIENT_KILLED:
            acting.kill()
            acting.join()
            notes.unlink()  # another arm, which begins at home
            acting = client()
        elif fault == SERVER_KILLED:
            server.kill()
            server.join()
            time.sleep(seconds / 2)
            with serving(checkpoint, port, notes, log):
                time.sleep(seconds / 2)
        time.sleep(seconds / 2)
        os.kill(acting.pid, signal.SIGINT)
        return ended(acting)


def lines(path: Path) -> int:
    """How many actions were noted."""
    return path.read_text().count("\n") if path.exists() else 0


def moves(checkpoint: str, notes: Path, until: float | None) -> dict[str, Any]:
    """How far the targets changed at most in one step, how fast, and how long steps took, the end's too."""
    largest = np.array(PreTrainedConfig.from_pretrained(checkpoint).trained_on.largest_change)
    if lines(notes) < 2:
        return {
            "actions": lines(notes),
            "jump": None,
            "fastest": None,
            "tick_99_s": None,
            "longest_hold_s": None,
        }
    rows = np.array([json.loads(line) for line in notes.read_text().splitlines()])
    changes = np.pad(np.abs(np.diff(rows[:, 1:], axis=0)) / largest, ((1, 1), (0, 0)))
    planned = np.maximum(1, np.maximum(changes[:-2], changes[2:]))
    return {
        "actions": len(rows),
        "jump": round(float((changes[1:-1] / planned).max()), 3),
        "fastest": round(float(changes.max()), 3),
        "tick_99_s": round(float(np.quantile(np.diff(rows[:, 0]), 0.99)), 4),
        "longest_hold_s": round(float(np.diff(rows[:, 0], append=until or rows[-1, 0]).max()), 3),
    }


def told(log: str) -> list[str]:
    """Warnings and errors, each kind once, without numbers and stamps."""
    found = (STAMP.sub("", line).strip() for line in TOLD.findall(log))
    return list(dict.fromkeys(re.sub(r"\d+(?:\.\d+)?", "#", line)[:160] for line in found if line))


def with_table(page: str, cells: list[dict[str, Any]]) -> str:
    """The page with the table of these results."""
    begin, end = page.index(BEGIN) + len(BEGIN), page.index(END)
    return page[:begin] + table(cells) + page[end:]


def table(cells: list[dict[str, Any]]) -> str:
    """Faults by modes: the largest jump, whether the command ended too early, and whether it said so."""
    by = {(each["mode"], each["fault"]): each for each in cells}
    usual = {mode: set(by[mode, "none"]["said"]) for mode in MODES if (mode, "none") in by}
    rows = [f"| fault | {' | '.join(MODES)} |", f"|---|{'---|' * len(MODES)}"]
    for fault in (*FAULTS, *KILLED):
        row = [_cell(by.get((mode, fault)), usual.get(mode, set())) for mode in MODES]
        rows.append(f"| {fault} | {' | '.join(row)} |")
    rows += ["", "| without a fault | " + " | ".join(MODES) + " |", f"|---|{'---|' * len(MODES)}"]
    for name, key in (
        ("99 % of the steps take at most [ms]", "tick_99_s"),
        ("the longest", "longest_hold_s"),
    ):
        times = [f"{1000 * by[mode, 'none'][key]:.0f}" for mode in MODES]
        rows.append(f"| {name} | {' | '.join(times)} |")
    return "\n".join(rows) + "\n"


def _cell(cell: dict[str, Any] | None, usual: set[str]) -> str:
    if cell is None:
        return "-"
    ended = ", stops" if cell["mode"] != "served" and cell["exit"] != 0 else ""
    told = ", told" if set(cell["said"]) - usual else ""
    return f"{cell['jump']:.2f}{ended}{told}"


def main() -> None:
    """Run the cells that are asked for, and write them down."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoint", nargs="?", type=Path)
    parser.add_argument("--table", action="store_true", help="write the table of the results, run nothing")
    parser.add_argument("--out", type=Path, default=RESULTS, help="file of the results")
    parser.add_argument("--seconds", type=float, default=8.0, help="for which each command acts")
    parser.add_argument("--modes", nargs="+", default=list(MODES), choices=list(MODES))
    parser.add_argument("--faults", nargs="+", default=[*FAULTS, *KILLED], choices=[*FAULTS, *KILLED])
    args = parser.parse_args()
    if args.table:
        PAGE.write_text(with_table(PAGE.read_text(), json.loads(RESULTS.read_text())))
        return
    os.environ.update({"HF_HUB_OFFLINE": "1", "MUJOCO_GL": os.environ.get("MUJOCO_GL", "egl")})
    args.checkpoint, args.out = args.checkpoint.absolute(), args.out.absolute()
    with TemporaryDirectory() as folder, chdir(folder):  # LeRobot's client writes logs where it is imported
        run_all(args)


def run_all(args: argparse.Namespace) -> None:
    """Run the cells one after the other; each is in the file when it is done."""
    for module in ("lerobot.scripts.lerobot_rollout", "lerobot.async_inference.robot_client"):
        import_module(module)
    cells = json.loads(args.out.read_text()) if args.out.exists() else []
    for mode in args.modes:
        for fault in args.faults:
            if fault in KILLED and mode != "served":
                continue
            with TemporaryDirectory() as folder:
                cell = run(str(args.checkpoint), mode, fault, args.seconds, Path(folder))
            print(json.dumps(cell), flush=True)
            cells = [each for each in cells if (each["mode"], each["fault"]) != (mode, fault)] + [cell]
            args.out.write_text(json.dumps(cells, indent=1) + "\n")


if __name__ == "__main__":
    main()
