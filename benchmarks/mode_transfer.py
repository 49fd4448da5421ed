"""Which policies hand the cube over in all the places that were demonstrated, as often; LeRobot's own, too.

    OMP_NUM_THREADS=1 MUJOCO_GL=egl nice -n 5 python benchmarks/mode_transfer.py

records 100 demonstrations of `transfer_modes` in the proportions 80/15/5, trains every policy for 1500 steps
of 64, asks `act-chunking modes` about it over 200 episodes, and writes benchmarks/results/mode_transfer.json
and the table of docs/instruments/modes.md. One training seed. What is done is kept in --folder.
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mode_study import PAGE, ROOT, act_chunking, cpu_seconds, show_on, table, train

from lerobot_act_chunking.durable_files import write_atomically

RESULTS = ROOT / "benchmarks/results/mode_transfer.json"
MARK = "<!-- modes of transfer_modes: python benchmarks/mode_transfer.py -->"
SHARES, DEMONSTRATIONS, STEPS = "80/15/5", 100, 1500
CPU = {"device": "cpu", "push_to_hub": "false"}
LEARNERS: dict[str, dict[str, Any]] = {
    "act_chunked, gmm": {"type": "act_chunked", "action_likelihood": "gmm", "action_temperature": 1},
    "diffusion_chunked": {"type": "diffusion_chunked"},
    "LeRobot's diffusion": {  # a second of motion, half of it executed, by a U-Net that a core can train
        "type": "diffusion",
        "horizon": 48,
        "n_action_steps": 24,
        "drop_n_last_frames": 23,
        "down_dims": "[32,64,128]",
        "noise_scheduler_type": "DDIM",
        "num_inference_steps": 10,
        "optimizer_lr": 1e-3,
        "scheduler_warmup_steps": 150,
    },
}


@dataclass(frozen=True)
class Study:
    """Where everything is kept, and over how many episodes a policy is asked."""

    folder: Path
    episodes: int

    def record(self) -> Path:
        """The demonstrations, recorded if they are not there."""
        dataset = self.folder / "demonstrations"
        shares = ("--mode-shares", SHARES.replace("/", ","), "--episodes", str(DEMONSTRATIONS))
        place = ("--repo-id", "local/transfer_modes", "--root", str(dataset))
        act_chunking("record", "--task", "transfer_modes", *shares, *place)
        return dataset

    def measure(self, name: str) -> dict[str, Any]:
        """What ``act-chunking modes`` says of the policy, trained if it is not there."""
        output = self.folder / name.replace(", ", "_").replace("'", "").replace(" ", "_")
        found, facts = output.with_suffix(".json"), output.with_suffix(".training.json")
        if not found.exists():
            if not facts.exists():
                dataset, started = self.record(), cpu_seconds()
                train({**CPU, **LEARNERS[name]}, STEPS, dataset, output)
                facts.write_text(json.dumps({"training_cpu_s": round(cpu_seconds() - started, 1)}))
            checkpoint = str(output / "checkpoints/last/pretrained_model")
            asked = ("--env.type=aloha_sim", "--env.task=transfer_modes", f"--episodes={self.episodes}")
            draft = found.with_suffix(".part")
            act_chunking("modes", checkpoint, *asked, "--json", str(draft))
            tried = {"shares": SHARES, "learner": name, "fix_tried": "none", "training_seed": 0}
            content = {**tried, **json.loads(facts.read_text()), **json.loads(draft.read_text())}
            content |= {"checkpoint": output.name, "dataset": Path(content["dataset"]).name}
            write_atomically(found, json.dumps(content).encode())
        return json.loads(found.read_text())


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--folder", type=Path, default=ROOT / "outputs/mode_transfer")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--learners", nargs="+", choices=LEARNERS, default=list(LEARNERS))
    parser.add_argument("--json", type=Path, default=RESULTS)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    done = [Study(args.folder, args.episodes).measure(name) for name in args.learners]
    write_atomically(args.json, (json.dumps(done, indent=1) + "\n").encode())
    show_on(PAGE, MARK, table(done))


if __name__ == "__main__":
    main()
