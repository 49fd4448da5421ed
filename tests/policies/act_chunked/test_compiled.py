import os
import subprocess
import sys
from pathlib import Path

from tiers import full_tier

SCRIPT = Path(__file__).with_name("compiled_process.py")


@full_tier
def test_a_compiled_policy_is_the_eager_one_for_every_batch_size():
    environment = {
        **os.environ,
        "HF_HUB_OFFLINE": "1",
        "OMP_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    command = [sys.executable, "-W", "ignore", str(SCRIPT)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    differences = [float(line) for line in done.stdout.split()]
    assert len(differences) == 6
    assert max(differences) < 1e-5
