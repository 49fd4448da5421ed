"""torch.compile takes every network part as one graph, and computes what it computes without."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from policy_cases import CASES
from tiers import full_tier

SCRIPT = Path(__file__).with_name("fullgraph_process.py")


@full_tier
@pytest.mark.parametrize("backend", ["eager", "aot_eager"])
def test_every_network_is_one_graph(backend):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-W", "ignore", str(SCRIPT), backend]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    differences = [float(line.split()[0]) for line in done.stdout.splitlines()]
    assert len(differences) == len(CASES) + 1
    assert max(differences) < 1e-5
