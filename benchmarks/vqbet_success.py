"""How well `vqbet_chunked` does its tasks, and what its parts are for: the tables of docs/policies/vqbet.md.

    OMP_NUM_THREADS=1 python benchmarks/vqbet_success.py --studies recipe
    OMP_NUM_THREADS=1 python benchmarks/vqbet_success.py --studies tokenizers parts sampling --tasks insertion

Studies: `recipe` (three training seeds), `tokenizers` (at the same number of steps), `parts` (one setting
changed at a time) and `sampling` (the recipe's first seed, acting otherwise). Every policy is trained by
lerobot-train on the recording of benchmarks/quickstart.py (made first if it is not there) and acts in the
same 200 episodes. Every training and every evaluation is written down when it is done, so the studies can be
stopped and gone on with, and may run side by side.
"""

from policy_study import run_studies
from vqbet_variants import STUDIES, VARIANTS

if __name__ == "__main__":
    run_studies("vqbet", __doc__, STUDIES, VARIANTS)
