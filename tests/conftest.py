"""One thread per test process, and every shape annotation of the tensor code checked while the tests run."""

import os

from jaxtyping import install_import_hook

# Before torch is imported, here or in a subprocess: workers that share cores must not spin on each other's.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Before anything imports them: annotations become checks only in modules that are imported afterwards.
CHECKED = (
    "nn",
    "heads",
    "sampling",
    "tokenizers",
    "execution",
    "data",
    "policies.act_chunked.network",
    "policies.diffusion_chunked.denoising",
    "execution.plan",
    "policies.vqbet_chunked.network",
)
install_import_hook([f"lerobot_act_chunking.{module}" for module in CHECKED], "beartype.beartype")
