"""One thread per test process, and every shape annotation of the tensor code checked while the tests run."""

import os

from jaxtyping import install_import_hook

# Before torch is imported, here or in a subprocess: workers that share cores must not spin on each other's.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Nothing that a test does may wait for a network, or depend on one.
os.environ.setdefault("HF_HUB_OFFLINE", "1")
os.environ["ACT_CHUNKING_FRAME_CACHE"] = "0"  # nor leave gigabytes behind

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
